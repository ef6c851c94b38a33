"""Checks deploy/kubernetes without a cluster; see run.sh."""

import argparse
import re
import tempfile
import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path

import broken
import keys
import network
import pods
import references
import ring
import schemas
import settings
from manifests import FOLDER, ROOT, Object, RenderError, of_kind, parse, render, workloads
from report import Report

Check = Callable[[list[Object]], Iterable[str]]

CHECKS: dict[str, Check] = {
    "every container has three probes through `lodestone healthcheck`": pods.probed,
    "requests, limits of memory and measured sizes agree": pods.bounded,
    "every pod meets the standard `restricted` with a read-only root": pods.unprivileged,
    "one of each but actors, tolerations only where they belong": pods.placed,
    "images are named by a tag and run their role": pods.imaged,
    "all roles are there and select their own pods": references.complete,
    "each pod sees its role's Secret alone": references.own_secrets,
    "volumes, claims and mounts belong together": references.volumes,
    "Services lead to ports of one workload": references.services,
    "budgets keep router and learner": references.budgets,
    "priorities and spreads name what is there": references.priorities,
    "every pod is denied everything by default": network.denied_by_default,
    "who may speak with whom is as agreed": network.as_agreed,
    "ports and policies meet": network.as_listened,
    "variables and arguments have values": settings.resolved,
}
# Expected properties of single overlays, in addition to the checks for all of them.
N_THREADS = 3000
EXAMPLE, SECOND = "docs/kubernetes.md", "another namespace"
SMALL_CORES, SMALL_MIB = 2.5, 1024


def sums(objects: list[Object]) -> tuple[float, float, int]:
    """Returns the total cores and MiB that all pods request, and the number of threads that step worlds."""
    cores = mib = 0.0
    n_threads = 0
    for workload in workloads(objects):
        box = workload.containers[0]
        cores += float(pods.quantity(box["resources"]["requests"]["cpu"])) * workload.replicas
        mib += float(pods.quantity(box["resources"]["requests"]["memory"])) / 2**20 * workload.replicas
        found = settings.variables(objects, workload, box)
        n_threads += int(found.get("LODESTONE_ACTOR__N_THREADS", 0)) * workload.replicas
    return cores, mib, n_threads


def purpose(name: str, objects: list[Object]) -> Iterable[str]:
    """Checks the properties specific to this overlay."""
    cores, mib, n_threads = sums(objects)
    print(f"        {name} asks for {cores:.1f} cores and {mib:.0f} MiB; {n_threads} threads step worlds")
    learner = of_kind(objects, "StatefulSet")[0]["spec"]["template"]["spec"]["containers"][0]
    if name == "small" and (cores > SMALL_CORES or mib > SMALL_MIB):
        yield f"asks for {cores} cores and {mib} MiB, more than {SMALL_CORES} and {SMALL_MIB}"
    if name == "thousands" and n_threads != N_THREADS:
        yield f"has {n_threads} threads, not {N_THREADS}"
    if ("nvidia.com/gpu" in learner["resources"]["limits"]) != (name == "gpu"):
        yield "the learner has a GPU in the wrong overlay"


def documented(kind: str) -> str:
    """Returns the first YAML block of this kind in the document."""
    text = (ROOT / EXAMPLE).read_text()
    # In a list, the block and its closing fence are indented.
    blocks = re.findall(r"^ *```yaml\n(.*?)^ *```", text, flags=re.DOTALL | re.MULTILINE)
    return textwrap.dedent(next(block for block in blocks if f"kind: {kind}\n" in block))


def example(target: Path) -> Path:
    """Creates the folder that the document tells the reader to write, next to a link to the repository."""
    folder = target / "my-run"
    folder.mkdir()
    (folder / "kustomization.yaml").write_text(documented("Kustomization"))
    (target / "lodestone").symlink_to(ROOT, target_is_directory=True)
    return folder


def second(target: Path) -> Path:
    """Creates a folder for a second run next to the first."""
    folder = target / "second"
    folder.mkdir()
    text = "namespace: second\nresources: [../lodestone/deploy/kubernetes/overlays/thousands]\n"
    (folder / "kustomization.yaml").write_text(text)
    return folder


def judge_folder(report: Report, name: str, objects: list[Object]) -> None:
    """Runs all checks that need no binary."""
    for version in schemas.VERSIONS:
        report.judge(
            f"{name}: {len(objects)} objects are valid for Kubernetes {version}, strictly",
            schemas.complaints(objects, version),
        )
    for what, check in CHECKS.items():
        report.judge(f"{name}: {what}", check(objects))


def judge_keys(report: Report, kubectl: str, folder: Path) -> None:
    """Checks the Secrets made from a folder of keys."""
    made = keys.make(kubectl, folder)
    for version in schemas.VERSIONS:
        report.judge(
            f"secrets.sh: Secrets are valid for Kubernetes {version}, strictly", schemas.complaints(made, version)
        )
    report.judge("secrets.sh: each role's files and no others", keys.content_complaints(kubectl, folder))
    report.judge("secrets.sh: the page's token is made once", keys.token_complaints(kubectl, folder))
    report.judge("secrets.sh: refuses what is incomplete", keys.refusal_complaints(kubectl, folder))


def no_secrets(folder: Path) -> Iterable[str]:
    """Checks that no file in the manifests contains a private key or has the suffix of one."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and (b"PRIVATE " + b"KEY" in path.read_bytes() or path.suffix in (".pem", ".key", ".crt")):
            yield f"{path.relative_to(ROOT)} is a secret, or looks like one"


def judge_all(report: Report, kubectl: str, binary: Path | None, scratch: Path) -> None:
    """Runs all checks, in an order that suits the reader of the output."""
    report.judge("no secret lies in the repository", no_secrets(FOLDER))
    folders = {path.name: path for path in sorted((FOLDER / "overlays").iterdir())}
    folders |= {"base": FOLDER / "base", EXAMPLE: example(scratch), SECOND: second(scratch)}
    rendered: dict[str, list[Object]] = {}
    for name, folder in folders.items():
        try:
            rendered[name] = render(kubectl, folder)
        except RenderError as error:
            report.judge(f"{name}: renders", [str(error)])
            continue
        judge_folder(report, name, rendered[name])
        if name not in (EXAMPLE, SECOND):
            report.judge(f"{name}: is what it is for", purpose(name, rendered[name]))
    for version in schemas.VERSIONS:
        found = schemas.complaints(parse(documented("Pod")), version)
        report.judge(f"{EXAMPLE}: the pod that copies is valid for Kubernetes {version}, strictly", found)
    for mistake in broken.MISTAKES:
        report.judge(f"is noticed: {mistake.what}", broken.overlooked(rendered["thousands"], mistake))
    if binary is None:
        keys.pretend(scratch / "keys")
        judge_keys(report, kubectl, scratch / "keys")
        report.skip("flags, variables and probes", "no --binary was given")
        return
    ring.make_keys(binary, scratch / "keys")
    judge_keys(report, kubectl, scratch / "keys")
    for name, objects in rendered.items():
        report.judge(f"{name}: the program knows every variable", settings.known(objects, binary))
        report.judge(
            f"{name}: the program takes flags and variables", settings.accepted(objects, binary, scratch / "keys")
        )
    ring.judge(report, kubectl, binary, rendered["small"], scratch)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kubectl", default="kubectl", help="kubectl 1.27 or newer")
    parser.add_argument("--binary", type=Path, help="lodestone, to try flags, variables and probes with")
    options = parser.parse_args()
    if options.binary and not options.binary.is_file():
        parser.error(f"{options.binary} is not there: build it with `cargo build`")
    report = Report()
    with tempfile.TemporaryDirectory(prefix="lodestone-kubernetes-") as scratch:
        judge_all(report, options.kubectl, options.binary and options.binary.resolve(), Path(scratch))
    return report.close()


if __name__ == "__main__":
    raise SystemExit(main())

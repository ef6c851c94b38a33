"""Assembles each container's variables and flags like Kubernetes and passes them to the program itself."""

import math
import os
import re
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

from manifests import Object, Workload, containers, of_kind
from pods import quantity

REFERENCE = re.compile(r"\$\(([A-Za-z_][A-Za-z0-9_]*)\)")
TOKEN = "page-0123456789abcdef"
# Settings without a double underscore that the program reads in addition to those in its help.
SHORT = {"LODESTONE_SEED", "LODESTONE_RUN", "LODESTONE_DEVICE"}
# Variables for libraries and drivers rather than the program.
FOREIGN = {"NVIDIA_DRIVER_CAPABILITIES", "XDG_CACHE_HOME"}
TIMEOUT_S = 60
WORKED = ("learner", "actor", "evaluator")


def pod_name(workload: Workload) -> str:
    """Returns a pod name like one that Kubernetes would generate."""
    return f"{workload.name}-0" if workload.object["kind"] == "StatefulSet" else f"{workload.name}-7c9d8f6b5d-x2x7k"


def variables(objects: list[Object], workload: Workload, container: Object) -> dict[str, str]:
    """Returns the environment variables of the container's process."""
    configs = {found["metadata"]["name"]: found["data"] for found in of_kind(objects, "ConfigMap")}
    found: dict[str, str] = {}
    for source in container.get("envFrom", []):
        found |= configs[source["configMapRef"]["name"]]
    for variable in container.get("env", []):
        found[variable["name"]] = value_of(variable, workload, container)
    return found


def value_of(variable: Object, workload: Workload, container: Object) -> str:
    """Returns the value of an entry of `env`."""
    if "value" in variable:
        return str(variable["value"])
    source = variable["valueFrom"]
    if source.get("fieldRef", {}).get("fieldPath") == "metadata.name":
        return pod_name(workload)
    if "resourceFieldRef" in source:
        section, _, name = source["resourceFieldRef"]["resource"].partition(".")
        amount = quantity(container["resources"][section][name])
        # Kubernetes rounds up, so 400m becomes 1.
        return str(math.ceil(amount / quantity(source["resourceFieldRef"].get("divisor", "1"))))
    if "secretKeyRef" in source:
        return TOKEN
    raise ValueError(f"{variable['name']} comes from {source}, which this check cannot read")


def arguments(container: Object, found: dict[str, str]) -> list[str]:
    """Returns the arguments with variables substituted. Like Kubernetes, leaves references to unset variables as is."""
    return [REFERENCE.sub(lambda match: found.get(match[1], match[0]), text) for text in container.get("args", [])]


def call(binary: Path, words: list[str], found: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Runs the program with these variables and without any other `LODESTONE_` variables."""
    others = {name: value for name, value in os.environ.items() if not name.startswith("LODESTONE_")}
    command = [str(binary), *words]
    try:
        return subprocess.run(
            command, capture_output=True, text=True, check=False, env={**others, **found}, timeout=TIMEOUT_S
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 124, "", f"did not end within {TIMEOUT_S} s")


def resolved(objects: list[Object]) -> Iterator[str]:
    """Checks that every variable is set once and not empty, and that arguments refer only to these variables."""
    for workload, container in containers(objects):
        names = [variable["name"] for variable in container.get("env", [])]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            yield f"{workload.name}: sets {', '.join(sorted(twice))} twice"
        found = variables(objects, workload, container)
        yield from (f"{workload.name}: {name} is empty" for name, value in found.items() if not value)
        left = [text for text in [*arguments(container, found), *found.values()] if "$(" in text]
        yield from (f"{workload.name}: {text} names a variable that is not there" for text in left)


def known(objects: list[Object], binary: Path) -> Iterator[str]:
    """Checks that each variable is in the role's help or is a setting. `accepted` tests the settings."""
    for workload, container in containers(objects):
        text = call(binary, [workload.role, "--help"], {}).stdout
        in_help = set(re.findall(r"\[env: ([A-Z_]+)", text))
        for name in variables(objects, workload, container):
            is_setting = workload.role in WORKED and (name in SHORT or "__" in name)
            if name not in in_help | FOREIGN and not is_setting:
                yield f"{workload.name}: `lodestone {workload.role} --help` does not have {name}"


def accepted(objects: list[Object], binary: Path, keys: Path) -> Iterator[str]:
    """Checks that the program accepts the flags and variables together and arrives at the intended configuration."""
    for workload, container in containers(objects):
        if workload.role not in WORKED:
            continue
        found = variables(objects, workload, container) | {"LODESTONE_KEYS": str(keys)}
        done = call(binary, [*arguments(container, found), "--print-config"], found)
        if done.returncode != 0:
            yield f"{workload.name}: exit {done.returncode}: {done.stderr.strip()}"
            continue
        yield from (f"{workload.name}: {text}" for text in differences(tomllib.loads(done.stdout), found))


def differences(config: Object, found: dict[str, str]) -> Iterator[str]:
    """Yields the differences between the program's full configuration and the variables."""
    expected = {
        "seed": found.get("LODESTONE_SEED"),
        "device": found.get("LODESTONE_DEVICE", "cpu"),
        "bus.run": found.get("LODESTONE_RUN"),
        "bus.connect": [found["LODESTONE_CONNECT"]],
        "bus.mode": "client",
        "actor.n_threads": found.get("LODESTONE_ACTOR__N_THREADS"),
        "learner.n_threads": found.get("LODESTONE_LEARNER__N_THREADS"),
        "evaluator.episodes.n_threads": found.get("LODESTONE_EVALUATOR__EPISODES__N_THREADS"),
    }
    for path, wanted in expected.items():
        value: object = config
        for key in path.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        if wanted is not None and (value if isinstance(wanted, list) else str(value)) != wanted:
            yield f"{path} is {value}, not {wanted}"

"""Assembles each container's variables and flags like Kubernetes and passes them to the program itself."""

import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from subprocess import CompletedProcess

from ..ring.processes import attempt, plain_environment
from .manifests import Object, Workload, of_kind, quantity, workloads

REFERENCE = re.compile(r"\$\(([A-Za-z_][A-Za-z0-9_]*)\)")
# Settings without a double underscore that the program reads in addition to those in its help.
SHORT = {"LODESTONE_SEED", "LODESTONE_RUN", "LODESTONE_DEVICE"}
# Variables for libraries and drivers rather than the program.
FOREIGN = {"NVIDIA_DRIVER_CAPABILITIES", "XDG_CACHE_HOME"}
CONFIGURED = ("learner", "actor", "evaluator")


def variables(objects: list[Object], workload: Workload) -> dict[str, str]:
    """Returns the environment variables of the container's process."""
    configs = {found["metadata"]["name"]: found["data"] for found in of_kind(objects, "ConfigMap")}
    found: dict[str, str] = {}
    for source in workload.box.get("envFrom", []):
        found |= configs.get(source.get("configMapRef", {}).get("name"), {})
    for variable in workload.box.get("env", []):
        found[variable["name"]] = value_of(variable, workload)
    return found


def value_of(variable: Object, workload: Workload) -> str:
    """Returns the value of an entry of `env`."""
    if "value" in variable:
        return str(variable["value"])
    source = variable["valueFrom"]
    if source.get("fieldRef", {}).get("fieldPath") == "metadata.name":
        return f"{workload.name}-7c9d8f6b5d-x2x7k"
    if "resourceFieldRef" in source:
        section, _, name = source["resourceFieldRef"]["resource"].partition(".")
        amount = quantity(workload.box["resources"][section][name])
        # Kubernetes rounds up, so 400m becomes 1.
        return str(math.ceil(amount / quantity(source["resourceFieldRef"].get("divisor", "1"))))
    if "secretKeyRef" in source:
        return "page-0123456789abcdef"
    raise ValueError(f"{variable['name']} comes from {source}, which this check cannot read")


def arguments(workload: Workload, found: dict[str, str]) -> list[str]:
    """Returns the arguments with variables substituted. Like Kubernetes, leaves references to unset variables as is."""
    return [REFERENCE.sub(lambda match: found.get(match[1], match[0]), text) for text in workload.box.get("args", [])]


def call(binary: Path, words: list[str], found: dict[str, str]) -> CompletedProcess[str]:
    """Runs the program with these variables and without any other `LODESTONE_` variables."""
    return attempt([binary, *words], {**plain_environment(), **found}, seconds=60)


def resolved(objects: list[Object]) -> Iterator[str]:
    """Checks that every variable is set once and not empty, and that arguments refer only to these variables."""
    for workload in workloads(objects):
        names = [variable["name"] for variable in workload.box.get("env", [])]
        yield from (f"{workload.name}: sets {name} twice" for name in set(names) if names.count(name) > 1)
        found = variables(objects, workload)
        yield from (f"{workload.name}: {name} is empty" for name, value in found.items() if not value)
        left = [text for text in [*arguments(workload, found), *found.values()] if "$(" in text]
        yield from (f"{workload.name}: {text} names a variable that is not there" for text in left)


def accepted(objects: list[Object], binary: Path, keys: Path) -> Iterator[str]:
    """Checks that the program knows each variable, takes flags and variables together, and arrives at what was meant."""
    for workload in workloads(objects):
        found = variables(objects, workload)
        is_configured = workload.role in CONFIGURED
        in_help = set(re.findall(r"\[env: ([A-Z_]+)", call(binary, [workload.role, "--help"], {}).stdout))
        for name in set(found) - in_help - FOREIGN:
            # Whether it is a setting, `--print-config` says.
            if not (is_configured and (name in SHORT or "__" in name)):
                yield f"{workload.name}: `lodestone {workload.role} --help` does not have {name}"
        if is_configured:
            found |= {"LODESTONE_KEYS": str(keys)}
            done = call(binary, [*arguments(workload, found), "--print-config"], found)
            if done.returncode != 0:
                yield f"{workload.name}: exit {done.returncode}: {done.stderr.strip()}"
                continue
            yield from (f"{workload.name}: {text}" for text in differences(tomllib.loads(done.stdout), found))


def differences(config: Object, found: dict[str, str]) -> Iterator[str]:
    """Yields the differences between the program's full configuration and the variables."""
    expected = {"bus.mode": "client", "bus.connect": f"['{found['LODESTONE_CONNECT']}']", "device": "cpu"}
    for name, wanted in found.items():
        if name in SHORT or name.endswith("_THREADS"):
            path = name.removeprefix("LODESTONE_").lower().replace("__", ".")
            expected["bus.run" if path == "run" else path] = wanted
    for path, wanted in expected.items():
        value: object = config
        for key in path.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        if str(value) != wanted:
            yield f"{path} is {value}, not {wanted}"

"""Renders manifests, and provides the parts of objects that several checks share."""

from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import yaml

from ..ring.processes import ROOT, run

Object = dict[str, Any]

FOLDER = ROOT / "deploy" / "kubernetes"
COMPONENT = "app.kubernetes.io/component"
ROLES = ("router", "learner", "actor", "evaluator")

UNITS: dict[str, Decimal | int] = {"": 1, "m": Decimal("0.001"), "Ki": 2**10, "Mi": 2**20, "Gi": 2**30}


def render(kubectl: str, folder: Path) -> list[Object]:
    """Renders the objects of a Kustomize folder."""
    return parse(run([kubectl, "kustomize", folder]))


def parse(text: str) -> list[Object]:
    """Parses a stream of YAML documents."""
    return [document for document in yaml.safe_load_all(text) if document]


@dataclass(frozen=True)
class Workload:
    """A Deployment, or the Job of a JobSet, with the labels and the `spec` of its pods and their only container."""

    spec: Object
    name: str
    replicas: int
    labels: dict[str, str]
    role: str
    pod: Object
    box: Object


def workloads(objects: list[Object]) -> list[Workload]:
    """Returns what creates pods. No check covers others, such as a StatefulSet, so `rules` rejects them."""
    specs = [(thing["metadata"]["name"], thing["spec"]) for thing in of_kind(objects, "Deployment")]
    for job in jobs(objects):
        specs.append((job["name"], job["template"]["spec"] | {"replicas": job["replicas"]}))
    found = []
    for name, spec in specs:
        labels, pod = spec["template"]["metadata"].get("labels", {}), spec["template"]["spec"]
        # One container: no check looks at others.
        [box] = pod.get("initContainers", []) + pod["containers"]
        found.append(Workload(spec, name, int(spec.get("replicas", 1)), labels, labels.get(COMPONENT, ""), pod, box))
    return found


def jobs(objects: list[Object]) -> list[Object]:
    """Returns the Jobs that JobSets are made of."""
    return [job for thing in of_kind(objects, "JobSet") for job in thing["spec"]["replicatedJobs"]]


def of_kind(objects: list[Object], *kinds: str) -> list[Object]:
    return [found for found in objects if found["kind"] in kinds]


def names(objects: list[Object], kind: str) -> list[str]:
    """Returns the names of the objects of a kind, in order."""
    return sorted(found["metadata"]["name"] for found in of_kind(objects, kind))


def shown(thing: Object) -> str:
    return f"{thing['kind']} {thing['metadata']['name']}"


def ports_of(workload: Workload) -> dict[str, int]:
    """Returns a container's ports by name."""
    return {port["name"]: port["containerPort"] for port in workload.box.get("ports", [])}


def quantity(text: str) -> Decimal:
    """Parses a quantity such as `250m` or `2Gi`."""
    digits = text.rstrip("mKMGi")
    return Decimal(digits) * UNITS[text[len(digits) :]]


def selects(selector: Object | None, labels: dict[str, str]) -> bool:
    """Returns whether a label selector matches. `{}` matches everything, None nothing."""
    if selector is None:
        return False
    wanted = selector.get("matchLabels", {}).items()
    rules = selector.get("matchExpressions", [])
    return all(labels.get(key) == value for key, value in wanted) and all(holds(rule, labels) for rule in rules)


def holds(rule: Object, labels: dict[str, str]) -> bool:
    """Returns whether an entry of `matchExpressions` matches."""
    if rule["operator"] != "In":
        raise ValueError(f"this check does not know the operator {rule['operator']}")
    return labels.get(rule["key"]) in rule["values"]

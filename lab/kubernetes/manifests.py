"""Renders manifests and provides the parts of rendered objects that several checks share."""

import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

Object = dict[str, Any]

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "deploy" / "kubernetes"
NAME = "app.kubernetes.io/name"
COMPONENT = "app.kubernetes.io/component"
ROLES = ("router", "learner", "actor", "evaluator")


class RenderError(Exception):
    """A kubectl failure, with its error output."""


def run(kubectl: str, *arguments: str) -> str:
    """Runs kubectl and returns its output."""
    done = subprocess.run([kubectl, *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RenderError(f"kubectl {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout


def render(kubectl: str, folder: Path) -> list[Object]:
    """Renders the objects of a Kustomize folder."""
    return parse(run(kubectl, "kustomize", str(folder)))


def parse(text: str) -> list[Object]:
    """Parses a stream of YAML documents."""
    return [document for document in yaml.safe_load_all(text) if document]


@dataclass(frozen=True)
class Workload:
    """A Deployment or StatefulSet with accessors for its pod template."""

    object: Object

    @property
    def name(self) -> str:
        return str(self.object["metadata"]["name"])

    @property
    def replicas(self) -> int:
        return int(self.object["spec"].get("replicas", 1))

    @property
    def labels(self) -> dict[str, str]:
        """Labels of the pods."""
        return dict(self.object["spec"]["template"]["metadata"].get("labels", {}))

    @property
    def role(self) -> str:
        return self.labels.get(COMPONENT, "")

    @property
    def pod(self) -> Object:
        """The pod's `spec`."""
        return dict(self.object["spec"]["template"]["spec"])

    @property
    def containers(self) -> list[Object]:
        """All containers, including init containers."""
        return [*self.pod.get("initContainers", []), *self.pod.get("containers", [])]


def of_kind(objects: list[Object], *kinds: str) -> list[Object]:
    """Returns the objects of the given kinds."""
    return [found for found in objects if found["kind"] in kinds]


def workloads(objects: list[Object]) -> list[Workload]:
    """Returns the objects that create pods. No check covers others, such as a Job, so `references` rejects them."""
    return [Workload(found) for found in of_kind(objects, "Deployment", "StatefulSet")]


def containers(objects: list[Object]) -> Iterator[tuple[Workload, Object]]:
    """Yields every container with its workload."""
    for workload in workloads(objects):
        for container in workload.containers:
            yield workload, container


def shown(thing: Object) -> str:
    """Returns the kind and name for messages."""
    return f"{thing['kind']} {thing['metadata']['name']}"


def selects(selector: Object | None, labels: dict[str, str]) -> bool:
    """Returns whether a label selector matches. `{}` matches everything, None nothing."""
    if selector is None:
        return False
    wanted = selector.get("matchLabels", {})
    rules = selector.get("matchExpressions", [])
    return all(labels.get(key) == value for key, value in wanted.items()) and all(holds(rule, labels) for rule in rules)


def holds(rule: Object, labels: dict[str, str]) -> bool:
    """Returns whether an entry of `matchExpressions` matches."""
    value = labels.get(rule["key"])
    match rule["operator"]:
        case "In":
            return value in rule["values"]
        case "NotIn":
            return value not in rule["values"]
        case "Exists":
            return value is not None
        case "DoesNotExist":
            return value is None
    raise ValueError(f"there is no operator {rule['operator']}")

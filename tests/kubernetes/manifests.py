"""Rendering, and the parts of rendered objects that several checks look at."""

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
    """kubectl refused, with its words."""


def run(kubectl: str, *arguments: str) -> str:
    """What kubectl prints."""
    done = subprocess.run([kubectl, *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RenderError(f"kubectl {' '.join(arguments)}: {done.stderr.strip()}")
    return done.stdout


def render(kubectl: str, folder: Path) -> list[Object]:
    """The objects of a Kustomize folder."""
    return parse(run(kubectl, "kustomize", str(folder)))


def parse(text: str) -> list[Object]:
    """The objects of several YAML documents."""
    return [document for document in yaml.safe_load_all(text) if document]


@dataclass(frozen=True)
class Workload:
    """A Deployment or StatefulSet with what its pods are made of."""

    object: Object

    @property
    def name(self) -> str:
        return str(self.object["metadata"]["name"])

    @property
    def replicas(self) -> int:
        return int(self.object["spec"].get("replicas", 1))

    @property
    def labels(self) -> dict[str, str]:
        """Those of the pods."""
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
        """All of them, those that run first too."""
        return [*self.pod.get("initContainers", []), *self.pod.get("containers", [])]


def of_kind(objects: list[Object], *kinds: str) -> list[Object]:
    """Those of certain kinds."""
    return [found for found in objects if found["kind"] in kinds]


def workloads(objects: list[Object]) -> list[Workload]:
    """All that makes pods here. Others, such as a Job, would be looked at by no check: see `references`."""
    return [Workload(found) for found in of_kind(objects, "Deployment", "StatefulSet")]


def containers(objects: list[Object]) -> Iterator[tuple[Workload, Object]]:
    """Every container with its workload."""
    for workload in workloads(objects):
        for container in workload.containers:
            yield workload, container


def shown(thing: Object) -> str:
    """Kind and name, for messages."""
    return f"{thing['kind']} {thing['metadata']['name']}"


def selects(selector: Object | None, labels: dict[str, str]) -> bool:
    """Whether a label selector matches; `{}` matches everything, an absent one nothing."""
    if selector is None:
        return False
    wanted = selector.get("matchLabels", {})
    rules = selector.get("matchExpressions", [])
    return all(labels.get(key) == value for key, value in wanted.items()) and all(holds(rule, labels) for rule in rules)


def holds(rule: Object, labels: dict[str, str]) -> bool:
    """Whether one of the `matchExpressions` does."""
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

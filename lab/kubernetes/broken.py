"""Tests the checks: each mistake, applied to the rendered objects, must make its check complain."""

import copy
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import network
import pods
import references
import schemas
import settings
from manifests import Object, of_kind

Check = Callable[[list[Object]], Iterable[str]]
Change = Callable[[Object], object]


def at(*path: str | int) -> Callable[[Object], Object]:
    """Returns a function that extracts the part of an object at a path."""

    def walk(thing: Object) -> Object:
        part: Object = thing
        for key in path:
            part = part[key]  # type: ignore[index]
        return part

    return walk


POD = at("spec", "template", "spec")
BOX = at("spec", "template", "spec", "containers", 0)
SPEC = at("spec")


class Mistake(NamedTuple):
    """A change to the first object of a kind and name, and the check that must find it."""

    what: str
    kind: str
    name: str
    change: Change
    check: Check


MISTAKES = [
    Mistake(
        "a field that no schema has",
        "Deployment",
        "actor",
        lambda d: POD(d).update(tolerance=[]),
        lambda o: schemas.complaints(o, schemas.VERSIONS[0]),
    ),
    Mistake(
        "a word where a number belongs",
        "Deployment",
        "actor",
        lambda d: SPEC(d).update(replicas="many"),
        lambda o: schemas.complaints(o, schemas.VERSIONS[1]),
    ),
    Mistake(
        "a container without readiness", "Deployment", "router", lambda d: BOX(d).pop("readinessProbe"), pods.probed
    ),
    Mistake(
        "a liveness probe that asks for a connection",
        "StatefulSet",
        "learner",
        lambda d: BOX(d)["livenessProbe"]["exec"]["command"].pop(),
        pods.probed,
    ),
    Mistake(
        "a container without a limit of memory",
        "Deployment",
        "actor",
        lambda d: BOX(d)["resources"].pop("limits"),
        pods.bounded,
    ),
    Mistake(
        "a request below what was measured",
        "StatefulSet",
        "learner",
        lambda d: BOX(d)["resources"]["requests"].update(memory="100Mi"),
        pods.bounded,
    ),
    Mistake(
        "a request above the limit",
        "Deployment",
        "actor",
        lambda d: BOX(d)["resources"]["requests"].update(memory="8Gi"),
        pods.bounded,
    ),
    Mistake(
        "a root that can be written",
        "Deployment",
        "evaluator",
        lambda d: BOX(d)["securityContext"].update(readOnlyRootFilesystem=False),
        pods.unprivileged,
    ),
    Mistake(
        "a capability",
        "Deployment",
        "router",
        lambda d: BOX(d)["securityContext"].update(capabilities={"add": ["NET_ADMIN"]}),
        pods.unprivileged,
    ),
    Mistake(
        "root", "StatefulSet", "learner", lambda d: POD(d)["securityContext"].update(runAsUser=0), pods.unprivileged
    ),
    Mistake(
        "a service account's token",
        "Deployment",
        "actor",
        lambda d: POD(d).pop("automountServiceAccountToken"),
        pods.unprivileged,
    ),
    Mistake(
        "variables of Services", "Deployment", "actor", lambda d: POD(d).pop("enableServiceLinks"), pods.unprivileged
    ),
    Mistake(
        "a folder of the node",
        "Deployment",
        "actor",
        lambda d: POD(d)["volumes"].append({"name": "x", "hostPath": {"path": "/"}}),
        pods.unprivileged,
    ),
    Mistake("two learners", "StatefulSet", "learner", lambda d: SPEC(d).update(replicas=2), pods.placed),
    Mistake(
        "two routers while one is replaced",
        "Deployment",
        "router",
        lambda d: SPEC(d)["strategy"].update(type="RollingUpdate"),
        pods.placed,
    ),
    Mistake(
        "a router that tolerates everything",
        "Deployment",
        "router",
        lambda d: POD(d).update(tolerations=[{"operator": "Exists"}]),
        pods.placed,
    ),
    Mistake(
        "an image without a tag",
        "Deployment",
        "actor",
        lambda d: BOX(d).update(image="registry.example.com:5000/lodestone"),
        pods.imaged,
    ),
    Mistake("a shell", "Deployment", "actor", lambda d: BOX(d).update(command=["sh", "-c"]), pods.imaged),
    Mistake(
        "an actor that is called evaluator",
        "Deployment",
        "actor",
        lambda d: BOX(d).update(args=["evaluator"]),
        pods.imaged,
    ),
    Mistake(
        "a selector that matches nothing",
        "Deployment",
        "actor",
        lambda d: SPEC(d)["selector"].update(matchLabels={"a": "b"}),
        references.complete,
    ),
    Mistake(
        "a namespace of another name",
        "Service",
        "router",
        lambda d: d["metadata"].update(namespace="default"),
        references.complete,
    ),
    Mistake(
        "the router's keys in an actor",
        "Deployment",
        "actor",
        lambda d: POD(d)["volumes"][0].update(secret={"secretName": "keys-router", "defaultMode": 288}),
        references.own_secrets,
    ),
    Mistake(
        "the page's token in an actor",
        "Deployment",
        "actor",
        lambda d: BOX(d)["envFrom"].append({"secretRef": {"name": "evaluator-page"}}),
        references.own_secrets,
    ),
    Mistake(
        "keys that everybody reads",
        "Deployment",
        "router",
        lambda d: [v["secret"].pop("defaultMode") for v in POD(d)["volumes"] if "secret" in v],
        references.own_secrets,
    ),
    Mistake(
        "a volume that is not there", "Deployment", "evaluator", lambda d: POD(d)["volumes"].pop(), references.volumes
    ),
    Mistake(
        "a claim that is not there",
        "PersistentVolumeClaim",
        "evaluator",
        lambda d: d["metadata"].update(name="other"),
        references.volumes,
    ),
    Mistake(
        "a ConfigMap that is not there",
        "Deployment",
        "actor",
        lambda d: BOX(d).update(envFrom=[{"configMapRef": {"name": "run"}}]),
        references.volumes,
    ),
    Mistake(
        "a Service for nobody",
        "Service",
        "router",
        lambda d: SPEC(d).update(selector={"app": "router"}),
        references.services,
    ),
    Mistake(
        "a Service to a port that is not there",
        "Service",
        "evaluator",
        lambda d: SPEC(d)["ports"][0].update(targetPort="http"),
        references.services,
    ),
    Mistake(
        "a Service with the program's name",
        "Service",
        "router",
        lambda d: d["metadata"].update(name="lodestone"),
        references.services,
    ),
    Mistake(
        "a page for the whole Internet",
        "Service",
        "evaluator",
        lambda d: SPEC(d).update(type="LoadBalancer"),
        references.services,
    ),
    Mistake(
        "a budget for nobody",
        "PodDisruptionBudget",
        "learner",
        lambda d: SPEC(d)["selector"].update(matchLabels={"a": "b"}),
        references.budgets,
    ),
    Mistake(
        "a budget that keeps nothing",
        "PodDisruptionBudget",
        "router",
        lambda d: SPEC(d).update(minAvailable=0),
        references.budgets,
    ),
    Mistake(
        "a priority that is not there",
        "Deployment",
        "actor",
        lambda d: POD(d).update(priorityClassName="none"),
        references.priorities,
    ),
    Mistake(
        "no denial by default",
        "NetworkPolicy",
        "default-deny",
        lambda d: SPEC(d).update(policyTypes=["Ingress"]),
        network.denied_by_default,
    ),
    Mistake(
        "a denial that forgets pods",
        "NetworkPolicy",
        "default-deny",
        lambda d: SPEC(d).update(podSelector={"matchLabels": {"a": "b"}}),
        network.denied_by_default,
    ),
    Mistake(
        "a router that is open to the namespace",
        "NetworkPolicy",
        "router",
        lambda d: SPEC(d)["ingress"][0].update({"from": [{"podSelector": {}}]}),
        network.as_agreed,
    ),
    Mistake(
        "a router that is open to all",
        "NetworkPolicy",
        "router",
        lambda d: SPEC(d)["ingress"][0].pop("from"),
        network.as_agreed,
    ),
    Mistake(
        "a page that is open to all namespaces",
        "NetworkPolicy",
        "evaluator",
        lambda d: SPEC(d)["ingress"][0].update({"from": [{"namespaceSelector": {}}]}),
        network.as_agreed,
    ),
    Mistake("clients without DNS", "NetworkPolicy", "clients", lambda d: SPEC(d)["egress"].pop(), network.as_agreed),
    Mistake(
        "clients that reach the Internet",
        "NetworkPolicy",
        "clients",
        lambda d: SPEC(d)["egress"][1]["to"].append({"ipBlock": {"cidr": "0.0.0.0/0"}}),
        network.as_agreed,
    ),
    Mistake(
        "a router on another port",
        "Deployment",
        "router",
        lambda d: BOX(d)["ports"][0].update(containerPort=7448),
        network.as_listened,
    ),
    Mistake(
        "a variable that is set twice",
        "Deployment",
        "actor",
        lambda d: BOX(d)["env"].append(BOX(d)["env"][0]),
        settings.resolved,
    ),
    Mistake(
        "a variable that is not there",
        "StatefulSet",
        "learner",
        lambda d: BOX(d)["args"].append("--steps=$(STEPS)"),
        settings.resolved,
    ),
]


def overlooked(objects: list[Object], mistake: Mistake) -> Iterator[str]:
    """Yields a complaint if the check misses the mistake, or complains about the unchanged objects."""
    if list(mistake.check(copy.deepcopy(objects))):
        yield "the check complains about what is right"
        return
    changed = copy.deepcopy(objects)
    mistake.change(next(found for found in of_kind(changed, mistake.kind) if found["metadata"]["name"] == mistake.name))
    if not list(mistake.check(changed)):
        yield "the check does not notice it"

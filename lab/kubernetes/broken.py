"""Tests the checks: each mistake, made in the rendered objects, must make them complain."""

import copy
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from ..ring.checks import require
from .manifests import Object, of_kind

POD = "spec.template.spec"
BOX = f"{POD}.containers.0"
JOB = "spec.replicatedJobs.0"
LEARNER = f"{JOB}.template.spec.template.spec"
FAILURES = f"{JOB}.template.spec.podFailurePolicy.rules"
MONITOR, ENDPOINT = "PodMonitor", "spec.podMetricsEndpoints.0"
ALERTS, RULES = "PrometheusRule", "spec.groups.0.rules"
ALERT = f"{RULES}.0"
VOLUME = {"name": "tmp", "emptyDir": {}}
NOTHING = {"matchLabels": {"a": "b"}}


class Mistake(NamedTuple):
    """A value at a path of the object with this kind and name. None removes what is there."""

    what: str
    kind: str
    name: str
    path: str
    value: Any


MISTAKES = [
    Mistake("a field that no schema has", "Deployment", "actor", f"{POD}.tolerance", []),
    Mistake("a word where a number belongs", "Deployment", "actor", "spec.revisionHistoryLimit", "many"),
    Mistake("no readiness", "Deployment", "router", f"{BOX}.readinessProbe", None),
    Mistake("liveness that asks for a connection", "Deployment", "actor", f"{BOX}.livenessProbe.exec.command.2", None),
    Mistake("a request below what was measured", "JobSet", "run", f"{LEARNER}.containers.0.resources.requests.memory", "100Mi"),
    Mistake("a capability", "Deployment", "router", f"{BOX}.securityContext.capabilities", {"add": ["NET_ADMIN"]}),
    Mistake("a service account's token", "Deployment", "actor", f"{POD}.automountServiceAccountToken", None),
    Mistake("a folder of the node", "Deployment", "actor", f"{POD}.volumes.0", {"name": "tmp", "hostPath": {"path": "/"}}),
    Mistake("two learners", "JobSet", "run", f"{JOB}.replicas", 2),
    Mistake("an actor that is called evaluator", "Deployment", "actor", f"{BOX}.args.0", "evaluator"),
    Mistake("a selector that matches nothing", "Deployment", "actor", "spec.selector", NOTHING),
    Mistake("the router's keys in an actor", "Deployment", "actor", f"{POD}.volumes.1.secret.secretName", "keys-router"),
    Mistake("keys that everybody reads", "Deployment", "router", f"{POD}.volumes.1.secret.defaultMode", None),
    Mistake("a claim that is not there", "PersistentVolumeClaim", "evaluator", "metadata.name", "other"),
    Mistake("a ConfigMap that is not there", "Deployment", "actor", f"{BOX}.envFrom.0.configMapRef.name", "run"),
    Mistake("a Service for nobody", "Service", "router", "spec.selector", {"app": "router"}),
    Mistake("a page for the whole Internet", "Service", "evaluator", "spec.type", "LoadBalancer"),
    Mistake("a router that autoscalers move", "Deployment", "router", "spec.template.metadata.annotations", {}),
    Mistake("a field that no JobSet has", "JobSet", "run", "spec.parallelism", 1),
    Mistake("a field that no Job has", "JobSet", "run", f"{JOB}.template.spec.replicas", 1),
    Mistake("a run that never ends", "JobSet", "run", "spec.successPolicy.targetReplicatedJobs", ["actor"]),
    Mistake("a drain that ends the run", "JobSet", "run", f"{LEARNER}.containers.0.args.2", None),
    Mistake("a learner that is given up when it is drained", "JobSet", "run", f"{FAILURES}.1.onExitCodes.values", [1]),
    Mistake("a monitor of another port", "PodMonitor", "evaluator", "spec.podMetricsEndpoints.0.port", "bus"),
    Mistake("a monitor of all pods", "PodMonitor", "evaluator", "spec.selector", {}),
    Mistake("an alert with a misspelled field", "PrometheusRule", "run", f"{ALERT}.expression", "1"),
    Mistake("an alert that nobody can read", "PrometheusRule", "run", f"{ALERT}.expr", "up =="),
    Mistake("an alert on what is not measured", "PrometheusRule", "run", f"{ALERT}.expr", "lodestone_learner_speed == 0"),
    Mistake("a priority that is not there", "Deployment", "actor", f"{POD}.priorityClassName", "none"),
    Mistake("no denial by default", "NetworkPolicy", "default-deny", "spec.policyTypes.1", None),
    Mistake("a router that is open to all", "NetworkPolicy", "router", "spec.ingress.0.from", None),
    Mistake("clients without DNS", "NetworkPolicy", "clients", "spec.egress.2", None),
    Mistake("clients that reach all", "NetworkPolicy", "clients", "spec.egress.2.to.1.ipBlock.cidr", "0.0.0.0/0"),
    Mistake("a router on another port", "Deployment", "router", f"{BOX}.ports.0.containerPort", 7448),
    Mistake("a variable that is set twice", "Deployment", "actor", f"{BOX}.env.1.name", "LODESTONE_CONNECT"),
    Mistake("a variable that is not there", "JobSet", "run", f"{LEARNER}.containers.0.args.3", "--steps=$(STEPS)"),
]
# What the schemas of custom resources and their metadata notice by themselves.
FOR_THE_SCHEMAS = [
    Mistake("a JobSet of another version", "JobSet", "run", "apiVersion", "jobset.x-k8s.io/v1"),
    Mistake("a JobSet without a version", "JobSet", "run", "apiVersion", None),
    Mistake("a JobSet without jobs", "JobSet", "run", "spec.replicatedJobs", None),
    Mistake("a policy that no JobSet has", "JobSet", "run", "spec.successPolicy.operator", "Most"),
    Mistake("a misspelled field of a JobSet's network", "JobSet", "run", "spec.network.enableDNSHostname", False),
    Mistake("a word where a number of Jobs belongs", "JobSet", "run", f"{JOB}.replicas", "1"),
    Mistake("more Jobs than 32 bits count", "JobSet", "run", f"{JOB}.replicas", 2**31),
    Mistake("a Job's template without pods", "JobSet", "run", f"{JOB}.template.spec.template", None),
    Mistake("a size that is none", "JobSet", "run", f"{LEARNER}.volumes.0.emptyDir.sizeLimit", "64MB"),
    Mistake("two volumes of one name", "JobSet", "run", f"{LEARNER}.volumes", [VOLUME, VOLUME]),
    Mistake("a null where a name belongs", "JobSet", "run", "spec.successPolicy.targetReplicatedJobs", [None]),
    Mistake("a misspelled field of a JobSet's metadata", "JobSet", "run", "metadata.label", {}),
    Mistake("a PodMonitor without its spec", MONITOR, "evaluator", "spec", None),
    Mistake("a PodMonitor without a selector", MONITOR, "evaluator", "spec.selector", None),
    Mistake("a misspelled field of an endpoint", MONITOR, "evaluator", f"{ENDPOINT}.period", "15s"),
    Mistake("a number where an interval belongs", MONITOR, "evaluator", f"{ENDPOINT}.interval", 15),
    Mistake("an interval without a unit", MONITOR, "evaluator", f"{ENDPOINT}.interval", "15"),
    Mistake("an authorization that there is not", MONITOR, "evaluator", f"{ENDPOINT}.authorization.type", "Basic"),
    Mistake("a token without its key", MONITOR, "evaluator", f"{ENDPOINT}.authorization.credentials.key", None),
    Mistake("a number in a PodMonitor's labels", MONITOR, "evaluator", "metadata.labels", {"a": 1}),
    Mistake("alerts of another version", ALERTS, "run", "apiVersion", "monitoring.coreos.com/v2"),
    Mistake("alerts without their spec", ALERTS, "run", "spec", None),
    Mistake("a group without a name", ALERTS, "run", "spec.groups.0.name", None),
    Mistake("an alert without an expression", ALERTS, "run", f"{ALERT}.expr", None),
    Mistake("an alert with a misspelled duration", ALERTS, "run", f"{ALERT}.for", "10min"),
    Mistake("a number among an alert's labels", ALERTS, "run", f"{ALERT}.labels.severity", 1),
    Mistake("an object where a list of alerts belongs", ALERTS, "run", RULES, {"alert": "A", "expr": "up"}),
    Mistake("two groups of one name", ALERTS, "run", "spec.groups", 2 * [{"name": "a", "rules": []}]),
    Mistake("a misspelled field of the alerts' metadata", ALERTS, "run", "metadata.label", {}),
]
# What only the program itself notices.
FOR_THE_PROGRAM = [
    Mistake("a setting of no role", "Deployment", "actor", f"{BOX}.env.0.name", "LODESTONE_ACTOR__N_THREAD"),
    Mistake("a flag of no role", "Deployment", "evaluator", f"{BOX}.args.1", "--run-folder=/runs/x"),
]


def changed(objects: list[Object], mistake: Mistake) -> list[Object]:
    """Returns a copy of the objects with the mistake."""
    copied = copy.deepcopy(objects)
    part: Any = next(found for found in of_kind(copied, mistake.kind) if found["metadata"]["name"] == mistake.name)
    *path, last = (int(key) if key.isdigit() else key for key in mistake.path.split("."))
    for key in path:
        part = part[key]
    if mistake.value is None:
        del part[last]
    else:
        part[last] = mistake.value
    return copied


def noticed(objects: list[Object], mistake: Mistake, check: Callable[[list[Object]], Iterable[str]]) -> str:
    """Returns the complaint about the mistake. Fails if there is none."""
    complaint = next(iter(check(changed(objects, mistake))), None)
    require(complaint, "no check notices it")
    return str(complaint)[:100]

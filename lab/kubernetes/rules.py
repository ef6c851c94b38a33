"""What no schema knows: pods are probed, bounded, unprivileged and apart, and names lead to what is there."""

from collections.abc import Iterator
from itertools import chain
from typing import Any

from .manifests import ROLES, Object, Workload, names, of_kind, ports_of, quantity, selects, shown, workloads

# Measured memory of each process in megabytes, with two-block goals. A pod that requests less may not have enough.
MEASURED_MB = {"router": 22, "learner": 183, "actor": 44, "evaluator": 59}
PROBES = {
    "startupProbe": ["lodestone", "healthcheck", "--alive"],
    "livenessProbe": ["lodestone", "healthcheck", "--alive"],
    "readinessProbe": ["lodestone", "healthcheck"],
}
# The Pod Security Standard `restricted` with a read-only root and the image's user.
POD = {
    "automountServiceAccountToken": False,
    # Kubernetes would make variables of Services, some of which the program could take for its own.
    "enableServiceLinks": False,
    **dict.fromkeys(("hostNetwork", "hostPID", "hostIPC")),
    "securityContext": {
        "runAsNonRoot": True,
        **dict.fromkeys(("runAsUser", "runAsGroup", "fsGroup"), 10001),
        "fsGroupChangePolicy": "OnRootMismatch",
        "seccompProfile": {"type": "RuntimeDefault"},
    },
}
# Autoscalers leave such a pod where it is.
STAYS = {"cluster-autoscaler.kubernetes.io/safe-to-evict": "false", "karpenter.sh/do-not-disrupt": "true"}
BOX = {"allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}}


def different(what: str, found: Any, wanted: Any) -> Iterator[str]:
    """Yields a complaint unless both are equal."""
    if found != wanted:
        yield f"{what}: {found}, not {wanted}"


def complaints(objects: list[Object]) -> Iterator[str]:
    """Yields what is wrong with the pods one by one, and with what leads from one object to another."""
    yield from different("roles", sorted(pod.role for pod in workloads(objects)), sorted(ROLES))
    for pod in workloads(objects):
        found = chain(container(pod), resources(pod), place(objects, pod), volumes(objects, pod))
        yield from (f"{pod.name}: {complaint}" for complaint in found)
    claimed = [volume.get("persistentVolumeClaim", {}) for pod in workloads(objects) for volume in pod.pod.get("volumes", [])]
    wanted = names(objects, "PersistentVolumeClaim")
    yield from different("claims", sorted(claim["claimName"] for claim in claimed if claim), wanted)
    # One for a single pod would block `kubectl drain` until somebody deletes that pod.
    yield from different("budgets", names(objects, "PodDisruptionBudget"), [])
    for service in of_kind(objects, "Service"):
        yield from (f"{shown(service)}: {complaint}" for complaint in reached(objects, service))


def container(pod: Workload) -> Iterator[str]:
    """Checks the probes, the privileges, and the command."""
    for probe, command in PROBES.items():
        yield from different(probe, pod.box.get(probe, {}).get("exec", {}).get("command"), command)
    for key, wanted in POD.items():
        yield from different(key, pod.pod.get(key), wanted)
    yield from different("the container's securityContext", pod.box.get("securityContext"), BOX)
    yield from different("command and role", [pod.box.get("command"), *pod.box["args"][:1]], [None, pod.role])


def resources(pod: Workload) -> Iterator[str]:
    """Checks that the request has room for what was measured, and is not above the limit."""
    requests, limits = (pod.box.get("resources", {}).get(kind, {}) for kind in ("requests", "limits"))
    if not {"cpu", "memory"} <= set(requests) or "memory" not in limits:
        yield f"lacks requests of cpu or memory, or a limit of memory: {requests}, {limits}"
        return
    yield from (f"asks for more than {limits}" for kind in limits if quantity(requests[kind]) > quantity(limits[kind]))
    if quantity(requests["memory"]) < MEASURED_MB.get(pod.role, 0) * 10**6:
        yield f"asks for {requests['memory']}, but {MEASURED_MB[pod.role]} MB were measured"


def place(objects: list[Object], pod: Workload) -> Iterator[str]:
    """Checks that there are never two but of actors, and that selectors take their own pods alone."""
    is_actor, is_learner = pod.role == "actor", pod.role == "learner"
    yield from different("more than one", pod.replicas > 1 and not is_actor, False)
    annotations = pod.spec["template"]["metadata"].get("annotations", {})
    is_moved = any(annotations.get(key) != value for key, value in STAYS.items())
    yield from different("an autoscaler may move it", is_moved, pod.role not in ("router", "learner"))
    strategy = None if is_learner else "RollingUpdate" if is_actor else "Recreate"
    yield from different("strategy", pod.spec.get("strategy", {}).get("type"), strategy)
    selectors = [rule.get("labelSelector") for rule in pod.pod.get("topologySpreadConstraints", [])]
    # Kubernetes itself chooses those of a Job.
    selectors += [] if is_learner else [pod.spec["selector"]]
    for selector in selectors:
        yield from different("pods of its selector", chosen_by(objects, selector), [pod.name])
    if (priority := pod.pod.get("priorityClassName")) and priority not in names(objects, "PriorityClass"):
        yield f"has the priority {priority}, which is not there"


def chosen_by(objects: list[Object], selector: Object | None) -> list[str]:
    """Returns the names of the workloads whose pods a selector takes."""
    return [pod.name for pod in workloads(objects) if selects(selector, pod.labels)]


def volumes(objects: list[Object], pod: Workload) -> Iterator[str]:
    """Checks that a pod mounts what is there at the paths in use, and of the Secrets those of its role alone."""
    chosen = {volume["name"]: volume for volume in pod.pod.get("volumes", [])}
    mounts = {mount["mountPath"]: mount for mount in pod.box.get("volumeMounts", [])}
    yield from different("volumes", sorted(chosen), sorted(mount["name"] for mount in mounts.values()))
    needed = {"/keys", "/tmp"} | ({"/runs"} if pod.role in ("learner", "evaluator") else set())
    yield from different("mounts", sorted(mounts), sorted(needed))
    yield from different("/keys is read-only", mounts.get("/keys", {}).get("readOnly"), True)
    for name, volume in chosen.items():
        if not {"secret", "emptyDir", "persistentVolumeClaim"} & set(volume):
            yield f"the volume {name} is of a kind that no pod here needs"
        if "secret" in volume:
            yield from different(name, volume["secret"], {"secretName": f"keys-{pod.role}", "defaultMode": 0o440})
    values = [variable.get("valueFrom", {}) for variable in pod.box.get("env", [])]
    secrets = [value["secretKeyRef"]["name"] for value in values if "secretKeyRef" in value]
    yield from different("Secrets of its variables", secrets, ["evaluator-page"] if pod.role == "evaluator" else [])
    for source in pod.box.get("envFrom", []):
        if source.get("configMapRef", {}).get("name") not in names(objects, "ConfigMap"):
            yield f"takes variables from {source}, which is not there"


def reached(objects: list[Object], service: Object) -> Iterator[str]:
    """Checks that a Service leads to ports of one workload and is not reached from outside the cluster."""
    spec = service["spec"]
    if service["metadata"]["name"] == "lodestone":
        yield "for one of that name Kubernetes makes variables that look like settings"
    yield from different("type", spec.get("type", "ClusterIP"), "ClusterIP")
    chosen = [pod for pod in workloads(objects) if selects({"matchLabels": spec.get("selector", {})}, pod.labels)]
    yield from different("workloads", len(chosen), 1)
    for port in spec.get("ports", []):
        there = [ports_of(pod).get(port["targetPort"]) for pod in chosen]
        yield from different(f"port {port['targetPort']}", there, [port["port"]])

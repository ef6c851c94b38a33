"""Checks that every pod is probed, bounded, unprivileged, and without access to the API server."""

from collections.abc import Iterator
from decimal import Decimal

from manifests import Object, Workload, containers, workloads

USER = 10001
# Measured memory of each process in megabytes, with two-block goals. A pod that requests less may not have enough.
MEASURED_MB = {"router": 22, "learner": 183, "actor": 44, "evaluator": 59}
PROBES = {
    "startupProbe": ["lodestone", "healthcheck", "--alive"],
    "livenessProbe": ["lodestone", "healthcheck", "--alive"],
    "readinessProbe": ["lodestone", "healthcheck"],
}
UNITS = {
    "": Decimal(1),
    "m": Decimal(1) / 1000,
    "k": Decimal(10) ** 3,
    "M": Decimal(10) ** 6,
    "G": Decimal(10) ** 9,
    "Ki": Decimal(2) ** 10,
    "Mi": Decimal(2) ** 20,
    "Gi": Decimal(2) ** 30,
}
# Volume types that the standard `restricted` allows.
VOLUMES = {"configMap", "csi", "downwardAPI", "emptyDir", "ephemeral", "persistentVolumeClaim", "projected", "secret"}


def quantity(text: str) -> Decimal:
    """Parses a quantity such as `250m` or `2Gi`."""
    digits = text.rstrip("".join({letter for unit in UNITS for letter in unit}))
    return Decimal(digits) * UNITS[text[len(digits) :]]


def probed(objects: list[Object]) -> Iterator[str]:
    """Checks that all probes run the program's health check, and that only a stalled process fails liveness."""
    for workload, container in containers(objects):
        for probe, command in PROBES.items():
            found = container.get(probe, {}).get("exec", {}).get("command")
            if found != command:
                yield f"{workload.name}: {probe} runs {found}, not {command}"


def bounded(objects: list[Object]) -> Iterator[str]:
    """Checks for CPU and memory requests and a memory limit, with request ≤ limit and room for the measured memory."""
    for workload, container in containers(objects):
        resources = container.get("resources", {})
        requests, limits = resources.get("requests", {}), resources.get("limits", {})
        missing = [f"requests.{name}" for name in ("cpu", "memory") if name not in requests]
        missing += ["limits.memory"] if "memory" not in limits else []
        if missing:
            yield f"{workload.name}: resources lack {', '.join(missing)}"
            continue
        for name, limit in limits.items():
            if quantity(requests.get(name, limit)) > quantity(limit):
                yield f"{workload.name}: asks for {requests[name]} of {name}, above its limit of {limit}"
        measured = MEASURED_MB.get(workload.role, 0) * Decimal(10) ** 6
        if quantity(requests["memory"]) < measured:
            yield f"{workload.name}: asks for {requests['memory']}, but {measured / 10**6} MB were measured"
        in_memory = sum(
            quantity(volume["emptyDir"].get("sizeLimit", "1000Gi"))
            for volume in workload.pod.get("volumes", [])
            if volume.get("emptyDir", {}).get("medium") == "Memory"
        )
        if in_memory + measured > quantity(limits["memory"]):
            yield f"{workload.name}: full volumes in memory leave no room for the process below {limits['memory']}"


def unprivileged(objects: list[Object]) -> Iterator[str]:
    """Checks for the Pod Security Standard `restricted`, a read-only root, and the image's user."""
    for workload in workloads(objects):
        yield from (f"{workload.name}: {complaint}" for complaint in pod_complaints(workload))
        for container in workload.containers:
            context = container.get("securityContext", {})
            wanted = {
                "allowPrivilegeEscalation": False,
                "readOnlyRootFilesystem": True,
                "capabilities": {"drop": ["ALL"]},
            }
            if context != wanted:
                yield f"{workload.name}: the container's securityContext is {context}, not {wanted}"
            if any("hostPort" in port for port in container.get("ports", [])):
                yield f"{workload.name}: takes a port of the node"


def pod_complaints(workload: Workload) -> Iterator[str]:
    """Checks the security settings of the pod as a whole."""
    pod = workload.pod
    context = pod.get("securityContext", {})
    wanted = {
        "runAsNonRoot": True,
        "runAsUser": USER,
        "runAsGroup": USER,
        "fsGroup": USER,
        "fsGroupChangePolicy": "OnRootMismatch",
        "seccompProfile": {"type": "RuntimeDefault"},
    }
    if context != wanted:
        yield f"the pod's securityContext is {context}, not {wanted}"
    if pod.get("automountServiceAccountToken") is not False:
        yield "the service account's token is mounted"
    if pod.get("enableServiceLinks") is not False:
        yield "variables of Services are made, some of which the program could take for its own"
    yield from (f"{key} is on" for key in ("hostNetwork", "hostPID", "hostIPC") if pod.get(key))
    for volume in pod.get("volumes", []):
        if not VOLUMES & set(volume):
            yield f"volume {volume['name']} is of a kind that the standard does not allow"


def placed(objects: list[Object]) -> Iterator[str]:
    """Checks that only actors tolerate spot nodes and only GPU pods tolerate GPU nodes.

    Also checks that every other role has one replica and never runs twice during an update.
    """
    for workload in workloads(objects):
        keys = {rule.get("key", "everything") for rule in workload.pod.get("tolerations", [])}
        has_gpu = any("nvidia.com/gpu" in box.get("resources", {}).get("limits", {}) for box in workload.containers)
        allowed = {"nvidia.com/gpu"} if has_gpu else set()
        if workload.role == "actor":
            allowed |= {"cloud.google.com/gke-spot", "kubernetes.azure.com/scalesetpriority"}
        if keys - allowed:
            yield f"{workload.name}: tolerates {', '.join(sorted(keys - allowed))}"
        if workload.role != "actor" and workload.replicas != 1:
            yield f"{workload.name}: there are {workload.replicas}, but a run has one"
        if workload.object["kind"] == "Deployment":
            kind = workload.object["spec"].get("strategy", {}).get("type")
            wanted_kind = "RollingUpdate" if workload.role == "actor" else "Recreate"
            if kind != wanted_kind:
                yield (
                    f"{workload.name}: strategy {kind} would run two at once"
                    if workload.role != "actor"
                    else (f"{workload.name}: strategy {kind} would stop all actors at once")
                )


def imaged(objects: list[Object]) -> Iterator[str]:
    """Checks that images have a tag other than `latest`, and containers run their role with the image's entry point."""
    for workload, container in containers(objects):
        image = container.get("image", "")
        name, _, tag = image.rpartition(":")
        if not name or not tag or tag == "latest" or "/" in tag:
            yield f"{workload.name}: the image {image} has no tag that says which it is"
        if "command" in container:
            yield f"{workload.name}: replaces the image's entry point"
        if container.get("args", [""])[0] != workload.role:
            yield f"{workload.name}: runs {container.get('args')}, not the role {workload.role}"

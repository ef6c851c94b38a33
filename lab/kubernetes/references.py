"""Checks that names used by one object belong to another: Secrets, volumes, Services, budgets."""

from collections.abc import Iterator

from manifests import COMPONENT, NAME, ROLES, Object, Workload, containers, of_kind, selects, shown, workloads

CLUSTER_WIDE = ("Namespace", "PriorityClass")
# Kinds that these checks understand. A new kind needs a check first.
KNOWN = {
    "ConfigMap",
    "Deployment",
    "Namespace",
    "NetworkPolicy",
    "PersistentVolumeClaim",
    "PodDisruptionBudget",
    "PriorityClass",
    "Service",
    "StatefulSet",
}
# Secret with the token of the evaluator's page. `secrets.sh` creates it along with the key Secrets.
EVALUATOR_PAGE = "evaluator-page"


def complete(objects: list[Object]) -> Iterator[str]:
    """Checks that each role exists once, in one namespace, with its own labels, and that all kinds are known."""
    roles = sorted(workload.role for workload in workloads(objects))
    if roles != sorted(ROLES):
        yield f"the roles are {roles}, not {sorted(ROLES)}"
    spaces = [found["metadata"]["name"] for found in of_kind(objects, "Namespace")]
    for thing in objects:
        if thing["kind"] not in KNOWN:
            yield f"{shown(thing)}: no check here looks at a {thing['kind']}"
        if thing["kind"] not in CLUSTER_WIDE and [thing["metadata"].get("namespace")] != spaces:
            yield f"{shown(thing)}: is not in the namespace {spaces}"
    for workload in workloads(objects):
        selector = workload.object["spec"]["selector"]
        if not selects(selector, workload.labels) or not selector.get("matchLabels"):
            yield f"{workload.name}: its selector does not match its own pods"
        if workload.labels.get(NAME) != "lodestone":
            yield f"{workload.name}: its pods lack the label {NAME}"
        also = [other.name for other in workloads(objects) if other != workload and selects(selector, other.labels)]
        if also:
            yield f"{workload.name}: its selector takes the pods of {', '.join(also)} as well"


def secrets_used(workload: Workload) -> set[str]:
    """Returns the names of all Secrets that a pod can access as files or variables."""
    volumes = workload.pod.get("volumes", [])
    used = {volume["secret"]["secretName"] for volume in volumes if "secret" in volume}
    for volume in volumes:
        parts = volume.get("projected", {}).get("sources", [])
        used |= {part["secret"]["name"] for part in parts if "secret" in part}
    for container in workload.containers:
        sources = container.get("envFrom", [])
        used |= {source["secretRef"]["name"] for source in sources if "secretRef" in source}
        values = [variable.get("valueFrom", {}) for variable in container.get("env", [])]
        used |= {value["secretKeyRef"]["name"] for value in values if "secretKeyRef" in value}
    return used


def own_secrets(objects: list[Object]) -> Iterator[str]:
    """Checks that each pod sees only its role's Secrets, in files that are group-readable and not writable."""
    for found in of_kind(objects, "Secret"):
        yield f"{shown(found)}: secrets do not belong into what is rendered"
    for workload in workloads(objects):
        allowed = {f"keys-{workload.role}"} | ({EVALUATOR_PAGE} if workload.role == "evaluator" else set())
        if secrets_used(workload) != allowed:
            yield f"{workload.name}: uses the Secrets {sorted(secrets_used(workload))}, not {sorted(allowed)}"
        for volume in workload.pod.get("volumes", []):
            if "secret" in volume and volume["secret"].get("defaultMode") != 0o440:
                yield f"{workload.name}: the files of {volume['name']} do not have the mode 0440"


def volumes(objects: list[Object]) -> Iterator[str]:
    """Checks that mounts have volumes, volumes have claims or sources, and keys and runs have the paths in use."""
    claims = {found["metadata"]["name"] for found in of_kind(objects, "PersistentVolumeClaim")}
    configs = {found["metadata"]["name"] for found in of_kind(objects, "ConfigMap")}
    claimed: list[str] = []
    for workload, container in containers(objects):
        templates = workload.object["spec"].get("volumeClaimTemplates", [])
        names = {volume["name"] for volume in [*workload.pod.get("volumes", []), *(t["metadata"] for t in templates)]}
        mounts = {mount["mountPath"]: mount for mount in container.get("volumeMounts", [])}
        for path, mount in mounts.items():
            if mount["name"] not in names:
                yield f"{workload.name}: {path} is of the volume {mount['name']}, which is not there"
        unused = names - {mount["name"] for mount in mounts.values()}
        if unused:
            yield f"{workload.name}: the volumes {sorted(unused)} are mounted nowhere"
        if not mounts.get("/keys", {}).get("readOnly"):
            yield f"{workload.name}: /keys is not mounted, or not read-only"
        needed = {"/keys", "/tmp"} | ({"/runs"} if workload.role in ("learner", "evaluator") else set())
        if set(mounts) != needed:
            yield f"{workload.name}: mounts {sorted(mounts)}, not {sorted(needed)}"
        for volume in workload.pod.get("volumes", []):
            claim = volume.get("persistentVolumeClaim", {}).get("claimName")
            claimed += [claim] if claim else []
            if claim and claim not in claims:
                yield f"{workload.name}: there is no PersistentVolumeClaim {claim}"
        for source in container.get("envFrom", []):
            if source.get("configMapRef", {}).get("name") not in configs:
                yield f"{workload.name}: takes variables from {source}, which is not there"
    if sorted(claimed) != sorted(claims):
        yield f"claims {sorted(claims)} are used as {sorted(claimed)}; each belongs to one pod"


def services(objects: list[Object]) -> Iterator[str]:
    """Checks that each Service selects the pods of one workload and ports that these pods have."""
    for service in of_kind(objects, "Service"):
        name, spec = shown(service), service["spec"]
        if service["metadata"]["name"] == "lodestone":
            yield f"{name}: for one of that name Kubernetes makes variables that look like settings"
        if spec.get("type", "ClusterIP") != "ClusterIP":
            yield f"{name}: can be reached from outside the cluster"
        chosen = [pod for pod in workloads(objects) if selects({"matchLabels": spec.get("selector", {})}, pod.labels)]
        if len(chosen) != 1:
            yield f"{name}: selects {[pod.name for pod in chosen]}, not one workload"
            continue
        ports = {port["name"]: port["containerPort"] for box in chosen[0].containers for port in box.get("ports", [])}
        for port in spec.get("ports", []):
            if ports.get(port["targetPort"]) != port["port"]:
                yield f"{name}: leads to {port['targetPort']}, but {chosen[0].name} has the ports {ports}"
    names = {found["metadata"]["name"] for found in of_kind(objects, "Service")}
    for found in of_kind(objects, "StatefulSet"):
        if found["spec"]["serviceName"] not in names:
            yield f"{shown(found)}: there is no Service {found['spec']['serviceName']}"


def budgets(objects: list[Object]) -> Iterator[str]:
    """Checks that the router and the learner have one disruption budget each, and nothing else has one."""
    kept: list[str] = []
    for budget in of_kind(objects, "PodDisruptionBudget"):
        chosen = [pod.role for pod in workloads(objects) if selects(budget["spec"].get("selector"), pod.labels)]
        if len(chosen) != 1:
            yield f"{shown(budget)}: selects {chosen}, not one workload"
        if budget["spec"].get("minAvailable") != 1:
            yield f"{shown(budget)}: keeps nothing"
        kept += chosen
    if sorted(kept) != ["learner", "router"]:
        yield f"budgets are for {sorted(kept)}, not for learner and router"


def priorities(objects: list[Object]) -> Iterator[str]:
    """Checks that named priority classes exist and that only actors use one. Also checks spreads and role labels."""
    classes = {found["metadata"]["name"] for found in of_kind(objects, "PriorityClass")}
    used = {workload.name: workload.pod.get("priorityClassName") for workload in workloads(objects)}
    for name, chosen in used.items():
        if chosen and (chosen not in classes or name != "actor"):
            yield f"{name}: has the priority {chosen}; there are {sorted(classes)}, for actors"
    for workload in workloads(objects):
        for rule in workload.pod.get("topologySpreadConstraints", []):
            if not selects(rule.get("labelSelector"), workload.labels):
                yield f"{workload.name}: spreads other pods than its own"
        if workload.labels.get(COMPONENT) != workload.name:
            yield f"{workload.name}: its label {COMPONENT} is {workload.labels.get(COMPONENT)}"

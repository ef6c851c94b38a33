"""Evaluates the NetworkPolicies like a network plugin and compares them with a table of allowed connections."""

import ipaddress
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

from manifests import COMPONENT, Object, of_kind, selects, shown, workloads

SYSTEM = {"kubernetes.io/metadata.name": "kube-system"}
OWN = {"kubernetes.io/metadata.name": "lodestone"}
MONITORING = {"kubernetes.io/metadata.name": "monitoring", "lodestone-page": "allowed"}
OTHER = {"kubernetes.io/metadata.name": "other"}


@dataclass(frozen=True)
class Peer:
    """A pod in some namespace, or an external address."""

    name: str
    labels: dict[str, str] = field(default_factory=dict)
    namespace: dict[str, str] = field(default_factory=lambda: OWN)
    ports: dict[str, int] = field(default_factory=dict)
    address: str = "10.1.2.3"
    is_pod: bool = True


def role(name: str, **ports: int) -> Peer:
    """Returns a pod of the run."""
    return Peer(name, {COMPONENT: name}, ports=ports)


ROUTER, LEARNER, ACTOR = role("router", **{"bus": 7447, "bus-tcp": 7447}), role("learner"), role("actor")
EVALUATOR, VIEWER = role("evaluator", page=8080), role("viewer")
STRANGER = Peer("a pod without labels in the namespace")
ELSEWHERE = Peer("a pod of another namespace with a role's label", {COMPONENT: "actor"}, OTHER)
PROMETHEUS = Peer("a pod of a namespace that was let in", {"app": "prometheus"}, MONITORING)
DNS = Peer("the cluster's DNS", {"k8s-app": "kube-dns"}, SYSTEM)
DNS_CACHE = Peer("the node's DNS cache", address="169.254.20.10", is_pod=False)
API = Peer("the API server", address="10.0.0.1", is_pod=False)
INTERNET = Peer("the Internet", address="192.0.2.1", is_pod=False)
METADATA = Peer("the cloud's metadata", address="169.254.169.254", is_pod=False)

ALLOWED: list[tuple[Peer, Peer, int, str]] = [
    *(
        (client, ROUTER, 7447, protocol)
        for client in (LEARNER, ACTOR, EVALUATOR, VIEWER)
        for protocol in ("UDP", "TCP")
    ),
    *(
        (client, names, 53, protocol)
        for client in (LEARNER, ACTOR, EVALUATOR, VIEWER)
        for names in (DNS, DNS_CACHE)
        for protocol in ("UDP", "TCP")
    ),
    (PROMETHEUS, EVALUATOR, 8080, "TCP"),
]
PEERS = [
    ROUTER,
    LEARNER,
    ACTOR,
    EVALUATOR,
    VIEWER,
    STRANGER,
    ELSEWHERE,
    PROMETHEUS,
    DNS,
    DNS_CACHE,
    API,
    INTERNET,
    METADATA,
]
PORTS = [(7447, "UDP"), (7447, "TCP"), (8080, "TCP"), (53, "UDP"), (53, "TCP"), (443, "TCP"), (80, "TCP"), (22, "TCP")]


def is_peer(rule: Object, peer: Peer) -> bool:
    """Returns whether an entry of `from` or `to` matches `peer`. A bare podSelector covers the policy's namespace."""
    if "ipBlock" in rule:
        block = rule["ipBlock"]
        inside = ipaddress.ip_address(peer.address) in ipaddress.ip_network(block["cidr"])
        # Network plugins differ in whether an ipBlock can match pod addresses, so it never matches pods here.
        return not peer.is_pod and inside and not block.get("except")
    if not peer.is_pod:
        return False
    if "namespaceSelector" in rule:
        if not selects(rule["namespaceSelector"], peer.namespace):
            return False
    elif peer.namespace != OWN:
        return False
    return "podSelector" not in rule or selects(rule["podSelector"], peer.labels)


def is_port(rules: list[Object] | None, target: Peer, port: int, protocol: str) -> bool:
    """Returns whether the rule's ports include this port of `target`. No ports means all ports."""
    if not rules:
        return True
    for rule in rules:
        wanted = rule.get("port", port)
        first = target.ports.get(wanted) if isinstance(wanted, str) else int(wanted)
        if first is None or rule.get("protocol", "TCP") != protocol:
            continue
        if first <= port <= int(rule.get("endPort", first)):
            return True
    return False


def lets(policies: list[Object], direction: str, subject: Peer, other: Peer, port: int, protocol: str) -> bool:
    """Returns whether the policies that select `subject` allow this traffic. Without such policies, all is allowed."""
    over = [
        policy["spec"]
        for policy in policies
        if direction in policy["spec"]["policyTypes"] and selects(policy["spec"]["podSelector"], subject.labels)
    ]
    side, target = ("from", subject) if direction == "Ingress" else ("to", other)
    rules = [rule for spec in over for rule in spec.get(direction.lower(), [])]
    return not over or any(
        (not rule.get(side) or any(is_peer(peer, other) for peer in rule[side]))
        and is_port(rule.get("ports"), target, port, protocol)
        for rule in rules
    )


def verdicts(policies: list[Object], source: Peer, target: Peer, port: int, protocol: str) -> Iterator[bool]:
    """Yields the verdict at each end that the policies cover. Neither end may rely on the other to refuse."""
    if is_own(source):
        yield lets(policies, "Egress", source, target, port, protocol)
    if is_own(target):
        yield lets(policies, "Ingress", target, source, port, protocol)


def is_own(peer: Peer) -> bool:
    """Returns whether `peer` is a pod in the run's namespace. The policies do not apply to others."""
    return peer.is_pod and peer.namespace == OWN


def denied_by_default(objects: list[Object]) -> Iterator[str]:
    """Checks that one policy selects every pod and allows nothing."""
    for policy in of_kind(objects, "NetworkPolicy"):
        spec = policy["spec"]
        is_over_all = spec["podSelector"] == {} and set(spec["policyTypes"]) == {"Ingress", "Egress"}
        if is_over_all and not spec.get("ingress") and not spec.get("egress"):
            return
    yield "no policy denies everything to every pod"


def as_agreed(objects: list[Object]) -> Iterator[str]:
    """Checks that exactly the pairs and ports in the table are allowed."""
    policies = of_kind(objects, "NetworkPolicy")
    for source, target in itertools.permutations(PEERS, 2):
        for port, protocol in PORTS:
            wanted = (source, target, port, protocol) in ALLOWED
            if any(found != wanted for found in verdicts(policies, source, target, port, protocol)):
                yield f"{source.name} {'cannot' if wanted else 'can'} reach {target.name} on {protocol} {port}"


def as_listened(objects: list[Object]) -> Iterator[str]:
    """Checks that the pods have the table's ports, and that every policy selects a pod."""
    for workload in workloads(objects):
        ports = {port["name"]: port["containerPort"] for box in workload.containers for port in box.get("ports", [])}
        table = next(peer.ports for peer in PEERS if peer.name == workload.role)
        if ports != table:
            yield f"{workload.name}: has the ports {ports}, the table of this check {table}"
    for policy in of_kind(objects, "NetworkPolicy"):
        selector = policy["spec"]["podSelector"]
        if not any(selects(selector, workload.labels) for workload in workloads(objects)):
            yield f"{shown(policy)}: is over no pod"

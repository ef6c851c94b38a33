"""Evaluates the NetworkPolicies like a network plugin and compares them with a table of allowed connections."""

import ipaddress
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

from .manifests import COMPONENT, Object, of_kind, ports_of, selects, shown, workloads

OWN = {"kubernetes.io/metadata.name": "lodestone"}
SYSTEM = {"kubernetes.io/metadata.name": "kube-system"}
OTHER = {"kubernetes.io/metadata.name": "other"}


@dataclass(frozen=True)
class Peer:
    """A pod in some namespace, or an external address."""

    name: str
    labels: dict[str, str] = field(default_factory=dict)
    namespace: dict[str, str] = field(default_factory=lambda: OWN)
    ports: dict[str, int] = field(default_factory=dict)
    address: str | None = None
    """None for a pod."""

    @property
    def is_own(self) -> bool:
        """Whether it is a pod in the run's namespace. The policies do not apply to others."""
        return self.address is None and self.namespace == OWN


ROUTER = Peer("router", {COMPONENT: "router"}, ports={"bus": 7447, "bus-tcp": 7447})
EVALUATOR = Peer("evaluator", {COMPONENT: "evaluator"}, ports={"page": 8080})
CLIENTS = [EVALUATOR, *(Peer(role, {COMPONENT: role}) for role in ("learner", "actor", "viewer"))]
PROMETHEUS = Peer("a pod of a namespace that was let in", {"app": "prometheus"}, {**OTHER, "lodestone-page": "allowed"})
NAMES = [Peer("the cluster's DNS", {"k8s-app": "kube-dns"}, SYSTEM), Peer("the node's DNS cache", address="169.254.20.10")]
OPENSHIFT = Peer("OpenShift's DNS", namespace={"kubernetes.io/metadata.name": "openshift-dns"})
STRANGERS = [
    Peer("a pod without labels in the namespace"),
    Peer("a pod of another namespace with a role's label", {COMPONENT: "actor"}, OTHER),
    Peer("the API server", address="10.0.0.1"),
    Peer("the Internet", address="192.0.2.1"),
    Peer("the cloud's metadata", address="169.254.169.254"),
]
PEERS = [ROUTER, *CLIENTS, PROMETHEUS, *NAMES, OPENSHIFT, *STRANGERS]
BOTH = ("UDP", "TCP")
ALLOWED = [
    *((client, ROUTER, 7447, protocol) for client in CLIENTS for protocol in BOTH),
    *((client, server, 53, protocol) for client in CLIENTS for server in NAMES for protocol in BOTH),
    *((client, OPENSHIFT, 5353, protocol) for client in CLIENTS for protocol in BOTH),
    (PROMETHEUS, EVALUATOR, 8080, "TCP"),
]
PORTS = [*((port, protocol) for port in (7447, 53, 5353) for protocol in BOTH), *((port, "TCP") for port in (8080, 443, 80, 22))]


def is_peer(rule: Object, peer: Peer) -> bool:
    """Returns whether an entry of `from` or `to` matches `peer`. A bare podSelector covers the policy's namespace."""
    if peer.address is not None:
        # Network plugins differ in whether an ipBlock can match pod addresses, so it never matches pods here.
        block = rule.get("ipBlock", {"cidr": "0.0.0.0/32"})
        return ipaddress.ip_address(peer.address) in ipaddress.ip_network(block["cidr"]) and not block.get("except")
    is_there = selects(rule["namespaceSelector"], peer.namespace) if "namespaceSelector" in rule else peer.namespace == OWN
    return "ipBlock" not in rule and is_there and selects(rule.get("podSelector", {}), peer.labels)


def is_port(rules: list[Object] | None, target: Peer, port: int, protocol: str) -> bool:
    """Returns whether the rule's ports include this port of `target`. No ports means all ports."""

    def includes(rule: Object) -> bool:
        wanted = rule.get("port", port)
        first = target.ports.get(wanted, -1) if isinstance(wanted, str) else int(wanted)
        return rule.get("protocol", "TCP") == protocol and first <= port <= int(rule.get("endPort", first))

    return not rules or any(map(includes, rules))


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


def policies(objects: list[Object]) -> Iterator[str]:
    """Checks that exactly the pairs and ports in the table are allowed, at each end that the policies cover.

    Neither end may rely on the other to refuse, so what is not in the table must be refused by both.
    """
    found = of_kind(objects, "NetworkPolicy")
    for source, target in itertools.permutations(PEERS, 2):
        for port, protocol in PORTS:
            ends = [lets(found, "Egress", source, target, port, protocol)] if source.is_own else []
            ends += [lets(found, "Ingress", target, source, port, protocol)] if target.is_own else []
            wanted = (source, target, port, protocol) in ALLOWED
            if any(end != wanted for end in ends):
                yield f"{source.name} {'cannot' if wanted else 'can'} reach {target.name} on {protocol} {port}"
    for workload in workloads(objects):
        table = next((peer.ports for peer in PEERS if peer.name == workload.role), None)
        if ports_of(workload) != table:
            yield f"{workload.name}: has the ports {ports_of(workload)}, the table of this check {table}"
    for policy in found:
        if not any(selects(policy["spec"]["podSelector"], workload.labels) for workload in workloads(objects)):
            yield f"{shown(policy)}: is over no pod"

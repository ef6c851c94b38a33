"""Attacks a router with each role's keys, with a stranger's keys, and with none, and prints what got through as JSON.

Usage: rogue.py ENDPOINT KEYS STRANGERS_KEYS RUN

KEYS is the folder that `lodestone keys new` created for the router at ENDPOINT. STRANGERS_KEYS is one from another
authority. Every payload starts with a marker. Witnesses with legitimate keys record the bus keys on which they receive
it.
"""

import json
import sys
import threading
from pathlib import Path

import zenoh

MARKER = b"rogue"
LARGE = 50_000_000
N_FLOOD = 2_000
#: Timeout for opening a session, in milliseconds.
OPENING_MS = 4_000
#: Timeout for a reply, in seconds.
PATIENCE_S = 10.0

TARGETS = {
    "put": ["weights/version/rogue", "weights/version/*", "weights/latest", "metrics/learner", "metrics/eval/summary", "metrics/actor/rogue",
            "trajectories/rogue", "live/learner/learner", "ingest/rogue", "anything/else"],
    "answer": ["weights/latest", "ingest/*", "metrics/learner", "metrics/eval/summary", "history/eval", "**"],
    "read": ["weights/**", "trajectories/*", "metrics/**", "**"],
    "ask": ["weights/latest", "ingest/rogue", "metrics/learner", "history/eval", "**"],
}


def config(endpoint: str, keys: Path | None, role: str) -> zenoh.Config:
    """Returns a client configuration with the keys of `role`, if any, and a short connection timeout."""
    made = zenoh.Config()
    made.insert_json5("mode", '"client"')
    made.insert_json5("connect/endpoints", json.dumps([endpoint]))
    made.insert_json5("connect/timeout_ms", str(OPENING_MS))
    made.insert_json5("connect/exit_on_failure", "true")
    made.insert_json5("scouting/multicast/enabled", "false")
    if keys is not None:
        folder = keys / role
        user, password = (folder / "password").read_text().strip().split(":", 1)
        tls = {
            "root_ca_certificate": str(folder / "ca.pem"),
            "connect_certificate": str(folder / "cert.pem"),
            "connect_private_key": str(folder / "key.pem"),
            "enable_mtls": True,
        }
        made.insert_json5("transport/link/tls", json.dumps(tls))
        made.insert_json5("transport/auth/usrpwd/user", json.dumps(user))
        made.insert_json5("transport/auth/usrpwd/password", json.dumps(password))
    return made


def opens(endpoint: str, keys: Path | None, role: str) -> bool:
    """Returns whether a session with these keys reaches a router."""
    return opens_with(config(endpoint, keys, role))


def opens_with(made: zenoh.Config) -> bool:
    """Returns whether a session with this configuration reaches a router."""
    try:
        with zenoh.open(made) as session:
            return bool(session.info.routers_zid())
    except zenoh.ZError:
        return False


class Witness:
    """Subscribes as a legitimate role and records the keys on which the marker arrived."""

    def __init__(self, session: zenoh.Session, prefix: str, keys: list[str]) -> None:
        self.seen: set[str] = set()
        self.n_honest = 0
        self._lock = threading.Lock()
        self._prefix = prefix
        self._subscribers = [session.declare_subscriber(f"{prefix}/{key}", self._hear) for key in keys]

    def _hear(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).removeprefix(f"{self._prefix}/")
        with self._lock:
            if sample.payload.to_bytes().startswith(MARKER):
                self.seen.add(key)
            elif sample.kind == zenoh.SampleKind.PUT:
                self.n_honest += 1


def answers(session: zenoh.Session, key: str, payload: bytes | None = None) -> list[bytes]:
    """Returns all replies to a query, including errors."""
    found = []
    for reply in session.get(key, payload=payload, timeout=PATIENCE_S, target=zenoh.QueryTarget.ALL):
        found.append(reply.ok.payload.to_bytes() if reply.ok else reply.err.payload.to_bytes())
    return found


def attack(session: zenoh.Session, prefix: str, witness_asks: zenoh.Session) -> dict[str, list[str]]:
    """Tries every attack with this session. Returns what it could read and where its own replies were accepted."""
    readers = {key: Witness(session, prefix, [key]) for key in TARGETS["read"]}
    queryables = []
    for key in TARGETS["answer"]:
        full = f"{prefix}/{key}"

        def answer(query: zenoh.Query, full: str = full) -> None:
            concrete = str(query.key_expr) if "*" in full else full
            query.reply(concrete, MARKER + b" answer")

        queryables.append(session.declare_queryable(full, answer, complete=True))
    for key in TARGETS["put"]:
        session.put(f"{prefix}/{key}", MARKER + b" put")
        session.put(f"{prefix}/{key}", MARKER + bytes(LARGE) if key.startswith("metrics") else MARKER + bytes(5_000))
        session.delete(f"{prefix}/{key}")
    got = [key for key in TARGETS["ask"] if any(not a.startswith(MARKER) for a in answers(session, f"{prefix}/{key}", b"?"))]
    # Legitimate queries while the impostor is active. They also give the puts above time to arrive.
    asked = ["weights/latest", "metrics/learner", "history/eval"]
    believed = [key for key in asked if any(a.startswith(MARKER) for a in answers(witness_asks, f"{prefix}/{key}"))]
    for queryable in queryables:
        queryable.undeclare()
    read = [key for key, reader in readers.items() if reader.n_honest]
    return {"read": read, "asked": got, "believed": believed}


def main() -> None:
    endpoint, keys, strangers, run = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4]
    prefix = f"lodestone/{run}"
    report: dict[str, object] = {
        "without_keys": opens(endpoint, None, ""),
        "without_encryption": opens(endpoint.replace("quic/", "tcp/"), None, ""),
        "stranger": opens(endpoint, strangers, "viewer"),
        "honest": opens(endpoint, keys, "viewer"),
    }
    # An actor's certificate with the learner's user and password must not pass for the learner: roles must match.
    mixed = config(endpoint, keys, "actor")
    user, password = (keys / "learner" / "password").read_text().strip().split(":", 1)
    mixed.insert_json5("transport/auth/usrpwd/user", json.dumps(user))
    mixed.insert_json5("transport/auth/usrpwd/password", json.dumps(password))
    report["mixed"] = opens_with(mixed)
    roles: dict[str, zenoh.Config] = {role: config(endpoint, keys, role) for role in ("viewer", "actor", "evaluator")}
    with zenoh.open(config(endpoint, keys, "viewer")) as viewer, zenoh.open(config(endpoint, keys, "evaluator")) as evaluator:
        attacks: dict[str, dict[str, list[str]]] = {}
        for role, its_config in roles.items():
            witnesses = [
                Witness(viewer, prefix, ["metrics/**"]),
                Witness(evaluator, prefix, ["weights/version/*", "trajectories/*", "metrics/**"]),
            ]
            with zenoh.open(its_config) as session:
                attacks[role] = attack(session, prefix, evaluator)
                if role == "actor":
                    # The learner refuses garbage under any actor's name, and replies to a part of it.
                    refusals = 0
                    for number in range(N_FLOOD):
                        refusals += len(answers(session, f"{prefix}/ingest/rogue-{number % 7}", MARKER + bytes(200)))
                    report["flood_answered"] = refusals
            attacks[role]["put"] = sorted(set().union(*(witness.seen for witness in witnesses)))
        report["attacks"] = attacks
    report["n_flood"] = N_FLOOD
    print(json.dumps(report))


if __name__ == "__main__":
    main()

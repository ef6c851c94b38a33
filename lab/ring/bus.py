"""Follows a run over its message bus, as any viewer may."""

import json
import socket
import threading
from collections import deque
from pathlib import Path
from typing import Any

try:
    import zenoh
except ModuleNotFoundError:
    raise SystemExit("this needs eclipse-zenoh: pip install -r deploy/examples/requirements.txt") from None

Report = dict[str, Any]

# A client that comes back by itself within half a second after its router was away.
PERSISTENT = {
    "connect/timeout_ms": -1,
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 200, "period_max_ms": 500, "period_increase_factor": 2},
}


def config(endpoint: str, keys: Path | None = None, more: dict[str, Any] | None = None) -> zenoh.Config:
    """Returns the configuration of a client, with one role's folder of keys, if any."""
    chosen: dict[str, Any] = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 5000,
        "scouting/multicast/enabled": False,
        **(more or {}),
    }
    if keys:
        user, password = (keys / "password").read_text().strip().split(":", 1)
        chosen["transport/auth/usrpwd"] = {"user": user, "password": password}
        chosen["transport/link/tls"] = {
            "root_ca_certificate": str(keys / "ca.pem"),
            "connect_certificate": str(keys / "cert.pem"),
            "connect_private_key": str(keys / "key.pem"),
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
    made = zenoh.Config()
    for key, value in chosen.items():
        made.insert_json5(key, json.dumps(value))
    return made


def latest(endpoint: str, keys: Path, key: str) -> list[Report]:
    """Returns the newest value of every key that matches `key`."""
    with zenoh.open(config(endpoint, keys)) as session:
        return [json.loads(reply.ok.payload.to_string()) for reply in session.get(key, timeout=5) if reply.ok]


def is_refused(endpoint: str) -> bool:
    """Returns whether the router refuses a client without keys."""
    try:
        with zenoh.open(config(endpoint)):
            return False
    except zenoh.ZError:
        return True


def listens(port: int) -> bool:
    """Returns whether somebody accepts connections on a port of this machine."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=1):
            return True
    except OSError:
        return False


class Listener:
    """Follows the metrics of a run across restarts of its router."""

    def __init__(self, port: int, run: str) -> None:
        self.wrong: list[str] = []
        self._prefix = f"lodestone/{run}/metrics/"
        self._config = config(f"tcp/127.0.0.1:{port}", more=PERSISTENT)
        self._samples: deque[tuple[str, bytes]] = deque()
        self._session: zenoh.Session | None = None
        self._lock = threading.Lock()

    def open(self) -> None:
        """Connects and subscribes. Call it when the router listens: zenoh waits forever, and cannot be stopped then."""
        session = zenoh.open(self._config)
        session.declare_subscriber(self._prefix + "**", self._push)
        with self._lock:
            self._session = session
            for reply in session.get(self._prefix + "actor/*", timeout=2):
                if reply.ok:
                    self._push(reply.ok)

    def take(self) -> list[tuple[str, Report]]:
        """Returns the key and the content of what came since the last call. `wrong` gets what is no JSON."""
        found = []
        while self._samples:
            key, payload = self._samples.popleft()
            try:
                found.append((key, json.loads(payload)))
            except ValueError as error:
                self.wrong.append(f"{key} is no JSON: {error}")
        return found

    def close(self) -> None:
        """Disconnects from the bus."""
        with self._lock:
            if self._session is not None:
                self._session.close()  # type: ignore[no-untyped-call]
                self._session = None

    def _push(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).removeprefix(self._prefix)
        self._samples.append((key, sample.payload.to_bytes()))

"""Queries the run over its message bus, as a viewer outside the containers."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import zenoh

from checks import Failed, require
from image import ROOT

EXAMPLES = ROOT / "deploy/examples"
sys.path.append(str(EXAMPLES))
from success import show_keys


def success(endpoint: str, keys: Path, run: str, seconds: float) -> dict[str, Any]:
    """Returns the newest complete evaluation, using the client in deploy/examples."""
    command = [sys.executable, str(EXAMPLES / "success.py"), endpoint, "--run", run, "--keys", str(keys), "--once"]
    try:
        told = subprocess.run(command, capture_output=True, timeout=seconds, check=False, env=os.environ)
    except subprocess.TimeoutExpired:
        raise Failed(f"success.py had nothing to print within {seconds:.0f} s") from None
    require(told.returncode == 0, f"success.py ended with {told.returncode}: {told.stderr.decode(errors='replace')[-600:]}")
    summary: dict[str, Any] = json.loads(told.stdout)
    return summary


def latest(endpoint: str, keys: Path, key: str) -> list[dict[str, Any]]:
    """Returns the newest value of every key that matches `key`."""
    with zenoh.open(_config(endpoint, keys)) as session:
        return [json.loads(reply.ok.payload.to_string()) for reply in session.get(key, timeout=5) if reply.ok]


def is_refused(endpoint: str) -> bool:
    """Returns whether the router refuses a client without keys."""
    try:
        with zenoh.open(_config(endpoint, None)):
            return False
    except zenoh.ZError:
        return True


def _config(endpoint: str, keys: Path | None) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("connect/timeout_ms", "5000")
    if keys:
        show_keys(config, keys)
    return config

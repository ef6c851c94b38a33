"""Checks that `secrets.sh` turns the folders of `lodestone keys new` into exactly the Secrets that pods mount."""

import base64
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

from manifests import FOLDER, ROLES, Object, parse

SCRIPT = FOLDER / "secrets.sh"
FILES = ("ca.pem", "cert.pem", "key.pem", "password")
TOKEN = re.compile(r"[A-Za-z0-9_-]{16,128}")


def pretend(folder: Path) -> None:
    """Fills a folder with the file names that `lodestone keys new` creates, for use without a binary."""
    for role in ("ca", "viewer", *ROLES):
        (folder / role).mkdir(parents=True)
        names = ("cert.pem", "key.pem") if role == "ca" else (*FILES, *(["users"] if role == "router" else []))
        for name in names:
            (folder / role / name).write_text(f"{name} of {role}\n")


def call(kubectl: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs the script."""
    variables = {**os.environ, "KUBECTL": kubectl}
    return subprocess.run([str(SCRIPT), *arguments], capture_output=True, text=True, check=False, env=variables)


def make(kubectl: str, folder: Path, namespace: str = "lodestone") -> list[Object]:
    """Returns the Secrets for a folder of keys."""
    done = call(kubectl, str(folder), namespace)
    if done.returncode != 0:
        raise RuntimeError(f"secrets.sh: {done.stderr.strip()}")
    return parse(done.stdout)


def files(secret: Object) -> dict[str, bytes]:
    """Returns the files that a pod sees when it mounts the Secret."""
    return {name: base64.b64decode(value) for name, value in secret["data"].items()}


def content_complaints(kubectl: str, folder: Path) -> Iterator[str]:
    """Checks that the Secrets hold each role's files and no others, in the requested namespace."""
    made = {secret["metadata"]["name"]: secret for secret in make(kubectl, folder, "elsewhere")}
    expected = {f"keys-{role}" for role in ROLES} | {"evaluator-page"}
    if set(made) != expected:
        yield f"there are {sorted(made)}, not {sorted(expected)}"
        return
    for role in ROLES:
        names = {*FILES, *(["users"] if role == "router" else [])}
        wanted = {name: (folder / role / name).read_bytes() for name in names}
        found = files(made[f"keys-{role}"])
        if found != wanted:
            yield f"keys-{role} has {sorted(found)}, or other content than the files {sorted(wanted)}"
    for name, secret in made.items():
        if secret["metadata"].get("namespace") != "elsewhere":
            yield f"{name} is in the namespace {secret['metadata'].get('namespace')}, not elsewhere"
    authority = (folder / "ca" / "key.pem").read_bytes()
    if any(authority in files(secret).values() for secret in made.values()):
        yield "the key that signs certificates is among them"


def token_complaints(kubectl: str, folder: Path) -> Iterator[str]:
    """Checks that the token is one that the evaluator accepts, stays the same, and is readable by its owner only."""
    tokens = {
        files(secret)["token"].decode()
        for _ in range(2)
        for secret in make(kubectl, folder)
        if "token" in secret["data"]
    }
    if len(tokens) != 1 or not all(TOKEN.fullmatch(token) for token in tokens):
        yield f"two calls give {len(tokens)} tokens, or one that is not 16 to 128 of A-Z, a-z, 0-9, - and _"
    mode = (folder / "page-token").stat().st_mode & 0o777
    if mode != 0o600:
        yield f"page-token has the mode {mode:o}, not 600"


def refusal_complaints(kubectl: str, folder: Path) -> Iterator[str]:
    """Checks that the script prints no Secrets unless all files exist, and that its message is helpful."""
    for arguments, expected in (
        ([], "usage: "),
        ([str(folder / "nowhere")], "lodestone keys new"),
        ([str(folder / "viewer")], "lodestone keys new"),
    ):
        done = call(kubectl, *arguments)
        if done.returncode != 2 or done.stdout or expected not in done.stderr:
            printed = f"prints {done.stdout!r} and {done.stderr!r}"
            yield f"`secrets.sh {' '.join(arguments)}`: exit {done.returncode}, {printed}"

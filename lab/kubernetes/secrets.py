"""Checks that `secrets.sh` turns the folders of `lodestone keys new` into exactly the Secrets that pods mount."""

import base64
import os
import re
from collections.abc import Iterator
from pathlib import Path
from subprocess import CompletedProcess

from ..ring.checks import require
from ..ring.processes import attempt
from .manifests import FOLDER, ROLES, Object, parse

FILES = ("ca.pem", "cert.pem", "key.pem", "password")


def call(kubectl: str, *arguments: str | Path) -> CompletedProcess[str]:
    """Runs the script."""
    return attempt([FOLDER / "secrets.sh", *arguments], {**os.environ, "KUBECTL": kubectl})


def make(kubectl: str, folder: Path, namespace: str = "lodestone") -> dict[str, Object]:
    """Returns the Secrets for a folder of keys by name."""
    done = call(kubectl, folder, namespace)
    require(done.returncode == 0, f"secrets.sh: {done.stderr.strip()}")
    return {secret["metadata"]["name"]: secret for secret in parse(done.stdout)}


def files(secret: Object) -> dict[str, bytes]:
    """Returns the files that a pod sees when it mounts the Secret."""
    return {name: base64.b64decode(value) for name, value in secret["data"].items()}


def contents(kubectl: str, folder: Path) -> Iterator[str]:
    """Checks that the Secrets hold each role's files and the page's token, and no others, in the requested namespace."""
    made = make(kubectl, folder, "elsewhere")
    expected = {"evaluator-page": {"token": (folder / "page-token").read_bytes()}}
    for role in ROLES:
        names = [*FILES, *(["users"] if role == "router" else [])]
        expected[f"keys-{role}"] = {name: (folder / role / name).read_bytes() for name in names}
    found = {name: files(secret) for name, secret in made.items()}
    if found != expected:
        yield f"there are {[(name, sorted(parts)) for name, parts in found.items()]}, or other content than the files"
    if {secret["metadata"].get("namespace") for secret in made.values()} != {"elsewhere"}:
        yield "they are not all in the namespace elsewhere"


def tokens(kubectl: str, folder: Path) -> Iterator[str]:
    """Checks that the token is one that the evaluator accepts, stays the same, and is readable by its owner only."""
    found = {files(make(kubectl, folder)["evaluator-page"])["token"].decode() for _ in range(2)}
    if len(found) != 1 or not all(re.fullmatch(r"[A-Za-z0-9_-]{16,128}", token) for token in found):
        yield f"two calls give {len(found)} tokens, or one that is not 16 to 128 of A-Z, a-z, 0-9, - and _"
    mode = (folder / "page-token").stat().st_mode & 0o777
    if mode != 0o600:
        yield f"page-token has the mode {mode:o}, not 600"


def refusals(kubectl: str, folder: Path) -> Iterator[str]:
    """Checks that the script prints no Secrets unless all files exist, and that its message is helpful."""
    for words, expected in (
        ([], "usage: "),
        ([folder / "nowhere"], "lodestone keys new"),
        ([folder / "viewer"], "lodestone keys new"),
    ):
        done = call(kubectl, *words)
        if done.returncode != 2 or done.stdout or expected not in done.stderr:
            yield f"`secrets.sh {words}`: exit {done.returncode}, prints {done.stdout!r} and {done.stderr!r}"


CHECKS = {
    "each role's files and no others": contents,
    "the page's token is made once": tokens,
    "refuses what is incomplete": refusals,
}

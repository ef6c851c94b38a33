"""Provides a Docker daemon: the running one, or one started here and stopped at the end."""

import contextlib
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from checks import Failed
from shell import works

# Flags to try in order. The second set is for machines whose disk is itself an overlay, the third for kernels without
# the tables that Docker needs, where docker-proxy alone publishes ports.
ATTEMPTS: tuple[tuple[str, ...], ...] = ((), ("--storage-driver=vfs",), ("--iptables=false", "--ip6tables=false"))

START_S = 60.0


def answers() -> bool:
    """Returns whether a daemon answers at the client's default address."""
    return works(["docker", "version", "--format", "{{.Server.Version}}"])


@contextlib.contextmanager
def daemon() -> Iterator[str]:
    """Provides a daemon that answers and yields its description."""
    if answers():
        yield "the daemon that runs already"
        return
    with tempfile.TemporaryDirectory(prefix="lodestone-dockerd-") as folder:
        process, how = _start(Path(folder))
        try:
            yield how
        finally:
            process.terminate()
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _start(folder: Path) -> tuple[subprocess.Popen[bytes], str]:
    ends: list[str] = []
    for number, flags in enumerate(ATTEMPTS):
        log = folder / f"dockerd-{number}.log"
        with log.open("wb") as out:
            process = subprocess.Popen(["dockerd", *flags], stdout=out, stderr=subprocess.STDOUT)
        if _comes_up(process):
            return process, " ".join(["a daemon of its own", *flags])
        process.kill()
        process.wait()
        last = log.read_text(errors="replace").strip().splitlines()[-3:]
        ends.append(" ".join(["dockerd", *flags]) + ":\n    " + "\n    ".join(last))
    raise Failed("dockerd does not start (it needs root, cgroups and iptables):\n  " + "\n  ".join(ends))


def _comes_up(process: subprocess.Popen[bytes]) -> bool:
    deadline = time.monotonic() + START_S
    while process.poll() is None and time.monotonic() < deadline:
        if answers():
            return True
        time.sleep(0.5)
    return False

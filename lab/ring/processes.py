"""Runs programs: to their end with their output, or beside this script with a log."""

import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from .checks import Failed, require

ROOT = Path(__file__).resolve().parents[2]

# More environment steps than a check can run.
ENDLESS = 1_000_000_000

Word = str | Path


def demand(binary: Path, programs: Mapping[str, str], more: Iterable[str] = ()) -> None:
    """Ends this script with code 2 if the binary or a program is missing; `programs` maps each to its package."""
    lacks = [] if binary.is_file() and os.access(binary, os.X_OK) else [f"{binary} is no program: `cargo build` makes it"]
    lacks += [f"{name} is missing (package {package})" for name, package in programs.items() if not shutil.which(name)]
    lacks += more
    if lacks:
        print("\n".join(lacks), file=sys.stderr)
        sys.exit(2)


def plain_environment() -> dict[str, str]:
    """Returns the environment without settings of Lodestone."""
    return {name: value for name, value in os.environ.items() if not name.startswith("LODESTONE_")}


def attempt(
    command: Sequence[Word], env: Mapping[str, str] | None = None, seconds: float = 300
) -> subprocess.CompletedProcess[str]:
    """Runs `command` to its end, whatever that is. Fails if it takes too long."""
    try:
        return subprocess.run(command, env=env, capture_output=True, text=True, errors="replace", timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        raise Failed(f"`{' '.join(map(str, command))}` was not done within {seconds:.0f} s") from None


def run(command: Sequence[Word], env: Mapping[str, str] | None = None, seconds: float = 300) -> str:
    """Returns what `command` prints to stdout. Fails with the end of its output if the command fails."""
    done = attempt(command, env, seconds)
    last = "\n".join((done.stdout + done.stderr).strip().splitlines()[-15:])
    require(done.returncode == 0, f"`{' '.join(map(str, command))}` ended with {done.returncode}: {last}")
    return done.stdout


def works(command: Sequence[Word]) -> bool:
    """Returns whether `command` exists and succeeds."""
    try:
        return attempt(command, seconds=60).returncode == 0
    except (OSError, Failed):
        return False


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Returns a port that was free a moment ago, for a process whose clients must know its port beforehand."""
    with socket.socket(type=kind) as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def settings(chosen: Mapping[str, object]) -> list[str]:
    """Returns the arguments for these settings."""
    return [argument for key, value in chosen.items() for argument in ("--set", f"{key}={value}")]


class Process:
    """A process with its output in a log. The kernel kills it when this script ends, for whatever reason."""

    def __init__(
        self,
        command: Sequence[Word],
        log: Path,
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
        stdin: int = subprocess.DEVNULL,
    ) -> None:
        self.log = log
        self.began = time.time()
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("ab") as output:
            # `setpriv` becomes the program, so the process id is the program's.
            self._popen = subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", *command],
                stdin=stdin,
                stdout=output,
                stderr=output,
                cwd=cwd,
                env=plain_environment() if env is None else env,
            )
        self.pid = self._popen.pid

    @property
    def code(self) -> int | None:
        """The exit code, or None while the process runs."""
        return self._popen.poll()

    def tell(self, line: str) -> None:
        """Writes a line to the process and closes its input."""
        assert self._popen.stdin is not None
        self._popen.stdin.write(f"{line}\n".encode())
        self._popen.stdin.close()

    def send(self, number: signal.Signals) -> None:
        if self.code is None:
            self._popen.send_signal(number)

    def kill(self) -> None:
        """Kills the process if it still runs."""
        self.send(signal.SIGKILL)
        self._popen.wait()

    def end(self, grace_s: float, wanted: int = 0) -> None:
        """Sends SIGTERM. Fails unless the process then ends with the wanted exit code in time."""
        require(self.code is None, f"it had ended before; it said {self.said()}")
        self.send(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._popen.wait(grace_s)
        code = self.code
        self.kill()
        require(code == wanted, f"{grace_s:.0f} s after SIGTERM its exit code was {code}; it said {self.said()}")

    def said(self) -> str:
        """Returns the end of the log."""
        return repr(self.log.read_text(errors="replace")[-600:])

    def panic(self) -> str | None:
        """Returns the line of the log that reports a panic, or None."""
        lines = self.log.read_text(errors="replace").splitlines()
        return next((f"{self.log.name}: {line}" for line in lines if "panicked" in line), None)

    def status(self, field: str) -> int | None:
        """Returns a number of /proc/PID/status, or None if the process is gone."""
        with contextlib.suppress(OSError):
            found = re.search(rf"^{field}:\s+(\d+)", Path(f"/proc/{self.pid}/status").read_text(), re.MULTILINE)
            return int(found[1]) if found else None
        return None

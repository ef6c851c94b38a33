"""Starts the ring of deploy/compose.yaml in containers, injects faults, and checks what was lost.

Usage: python lab/compose --binary target/debug/lodestone [--compose COMMAND] [--patience X] [--keep]

Needs root, the Debian packages docker.io, docker-compose, debootstrap, and iptables (or a daemon and Compose from
elsewhere), the Python package eclipse-zenoh, and `strip`. With the package prometheus, it also checks monitoring. It
installs nothing. Starts a daemon if none is running and stops it at the end. The last line counts the checks. The exit
code is 0 if all passed.
"""

import argparse
import importlib.util
import os
import shutil
import signal
import sys
from pathlib import Path

# Write no bytecode next to the modules in this folder.
sys.dont_write_bytecode = True

from checks import Patience, Tally
from daemon import daemon
from shell import works

# Program -> Debian package that provides it.
PROGRAMS = {"docker": "docker.io", "debootstrap": "debootstrap", "strip": "binutils", "tar": "tar"}

COMPOSE = (["docker-compose"], ["docker", "compose"])


def missing() -> list[str]:
    """Returns the unmet requirements as messages."""
    found = [f"{program} is missing (package {name})" for program, name in PROGRAMS.items() if not shutil.which(program)]
    if importlib.util.find_spec("zenoh") is None:
        found.append("the Python package eclipse-zenoh is missing (pip install -r deploy/examples/requirements.txt)")
    if not any(works([*command, "version"]) for command in COMPOSE):
        found.append("Compose is missing (package docker-compose, or the plugin of Compose v2)")
    if os.geteuid() != 0:
        found.append("only root can make a base image and kill processes in containers")
    return found


def arguments() -> argparse.Namespace:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, required=True, help="the program to put into the image")
    parser.add_argument("--compose", help="`docker-compose` or `docker compose` [default: both, where they are]")
    parser.add_argument("--patience", type=float, default=1.0, metavar="X", help="wait X times as long, on a busy machine")
    parser.add_argument("--keep", action="store_true", help="leave containers, volumes and image of a failed run")
    return parser.parse_args()


def main() -> int:
    """Runs all checks and returns the exit code."""
    args = arguments()
    if lacks := missing():
        print("\n".join(lacks), file=sys.stderr)
        return 2
    if not args.binary.is_file():
        print(f"{args.binary} is no file: build it with `cargo build`", file=sys.stderr)
        return 2
    import scenario  # It needs what may be missing.

    # Exit cleanly on SIGTERM, for example from a time limit, so that nothing is left behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    Patience.factor = args.patience
    tally = Tally()
    with daemon() as which:
        print(f"Docker: {which}", flush=True)
        commands = [args.compose.split()] if args.compose else [c for c in COMPOSE if works([*c, "version"])]
        scenario.run(tally, args.binary, commands, args.keep)
    print(tally.closing_line())
    return 1 if tally.n_failed else 0


if __name__ == "__main__":
    sys.exit(main())

"""Starts the ring of deploy/compose.yaml in containers, injects faults, and checks what was lost.

Usage: python3 -m lab.compose --binary target/debug/lodestone [--compose COMMAND] [--patience X] [--keep]

Needs root, a Docker daemon that runs, Compose, debootstrap, and the Python package eclipse-zenoh. With the package
prometheus, it also checks monitoring. It installs nothing. The last line counts the checks. The exit code is 0 if all
passed.
"""

import argparse
import os
import signal
import sys
import tempfile
from pathlib import Path

from ..ring.checks import Patience, Tally
from ..ring.processes import demand, run, works
from .image import image_is_plain, read_sources, remove_image, runtime_image
from .ring import Ring
from .scenario import Scenario

# Program -> Debian package that provides it.
PROGRAMS = {"docker": "docker.io", "debootstrap": "debootstrap", "strip": "binutils", "tar": "tar", "setpriv": "util-linux"}

COMPOSE = (["docker-compose"], ["docker", "compose"])

# After this many failures, the remaining checks would only time out.
ENOUGH = 3


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python3 -m lab.compose", description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, required=True, help="the program to put into the image")
    parser.add_argument("--compose", help="`docker-compose` or `docker compose` [default: both, where they are]")
    parser.add_argument("--patience", type=float, default=1.0, metavar="X", help="wait X times as long, on a busy machine")
    parser.add_argument("--keep", action="store_true", help="leave containers, volumes and image of a failed run")
    return parser.parse_args()


def main() -> int:
    """Runs all checks with each of the Compose commands and returns the exit code."""
    args = arguments()
    composes = [args.compose.split()] if args.compose else [command for command in COMPOSE if works([*command, "version"])]
    lacks = [] if composes else ["Compose is missing (package docker-compose, or the plugin of Compose v2)"]
    lacks += [] if works(["docker", "version"]) else ["no Docker daemon answers: start dockerd"]
    lacks += [] if os.geteuid() == 0 else ["only root can make a base image and kill processes in containers"]
    demand(args.binary, PROGRAMS, lacks)
    # Exit cleanly on SIGTERM, for example from a time limit, so that nothing is left behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    Patience.factor = args.patience
    tally, image = Tally(enough=ENOUGH), f"lodestone-test:{os.getpid()}"
    if not tally.check("the image is built", lambda: f"{runtime_image(args.binary, image) / 1e6:.0f} MB"):
        return tally.close()
    try:
        tally.check("cargo finds every crate in the context", lambda: read_sources(image))
        tally.check("the image needs no shell and no root", lambda: image_is_plain(image))
        for number, compose in enumerate(composes):
            print(f"\nwith {run([*compose, 'version']).splitlines()[0]}", flush=True)
            with tempfile.TemporaryDirectory(prefix="lodestone-compose-") as folder:
                ring = Ring(compose, f"lodestone-test-{os.getpid()}-{number}", image)
                Scenario(tally, ring, Path(folder)).play(args.keep)
    finally:
        if not (args.keep and tally.n_failed):
            remove_image(image)
    return tally.close()


if __name__ == "__main__":
    sys.exit(main())

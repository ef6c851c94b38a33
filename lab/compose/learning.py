"""Trains a preset with deploy/compose.yaml and many actors, and prints what it learned, with lag and sample size.

Usage: python3 -m lab.compose.learning --binary target/debug/lodestone [--actors 8] [--steps 200000]

It has the needs of `python3 -m lab.compose`.
"""

import argparse
import json
import os
import signal
import sys
from pathlib import Path

from ..ring import processes, records
from ..ring.checks import require, until
from . import ring as compose
from .image import remove_image, runtime_image

PRESET = "quickstart"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python3 -m lab.compose.learning", description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, required=True, help="the program to put into the image")
    parser.add_argument("--compose", default="docker-compose")
    parser.add_argument("--actors", type=int, default=8)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--limit", type=float, default=3600, metavar="SECONDS")
    args = parser.parse_args()
    # Ends cleanly, so that nothing is left behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    compose.PRESET = PRESET
    image = f"lodestone-learning:{os.getpid()}"
    runtime_image(args.binary, image)
    ring = compose.Ring(args.compose.split(), f"lodestone-learning-{os.getpid()}", image)
    try:
        ring.up("--scale", f"actor={args.actors}", steps=args.steps)
        ring.wait_alive("actor", args.actors)

        def has_ended() -> bool:
            state = compose.inspect(ring.container("learner"))["State"]
            require(not state["Running"] and state["ExitCode"] == 0, f"{ring.n_steps()} steps")
            return True

        until("the learner has its steps", args.limit, has_ended, forgive=(Exception,))
        run = ring.run_folder()
        report(run, args.actors, args.binary)
    finally:
        ring.down("--volumes")
        remove_image(image)


def report(run: Path, n_actors: int, binary: Path) -> None:
    updates = records.entries(run, "learner")
    seconds, n_steps = updates[-1]["elapsed_s"], updates[-1]["n_env_steps"]
    lags = [update["policy_lag_mean"] for update in updates]
    samples = [update["ppo"]["effective_sample_size"] for update in updates]
    print(f"{n_actors} actors, {n_steps} steps in {seconds:.0f} s, {n_steps / seconds:.0f} steps/s")
    print(f"policy lag {sum(lags) / len(lags):.2f} versions on average, {max(update['policy_lag_max'] for update in updates)} at most")
    print(f"effective sample size {sum(samples) / len(samples):.3f} on average, {min(samples):.3f} at least")
    # Of the last weights; the evaluator of the ring was not due yet.
    told = json.loads(processes.run([binary, "eval", "--checkpoint", run / "checkpoints", "--json"], seconds=900))
    for group in told["summary"]["groups"]:
        success = group["sampled"]["success"]
        low, high = 100 * success["wilson_low"], 100 * success["wilson_high"]
        print(f"{group['name']}: {100 * success['rate']:.1f}% ({low:.1f}–{high:.1f}) of {success['n_episodes']} sampled episodes")


if __name__ == "__main__":
    main()

"""Draws success in training of several learners, over environment steps and over minutes.

    pip install matplotlib
    python python/examples/ppo.py --metrics ppo.jsonl
    lodestone train --steps 4e4 --run-dir runs/peer \\
        --set 'actor.tasks.filter={sizes={min=2,max=2}}'
    python lab/learning.py learning.png "one file=ppo.jsonl" lodestone=runs/peer/metrics.jsonl

Files of one name, such as those of several seeds, look the same. Success is that of the last 200 episodes at least, so
it says something about the goals and starts that a learner trains on: give all of them the same.
"""

from __future__ import annotations

import json
import sys
from collections import deque
from pathlib import Path
from typing import NamedTuple

# A point of a curve takes in at least so many episodes.
N_EPISODES = 200


class Moment(NamedTuple):
    n_env_steps: int
    minutes: float
    success: float


def curve(path: Path) -> list[Moment]:
    """Reads the learner's lines of a `metrics.jsonl`, or those that `ppo.py --metrics` writes."""
    moments = []
    window: deque[tuple[int, int]] = deque()
    n_built = n_ended = 0
    for number, line in enumerate(path.read_text().splitlines(), 1):
        try:
            update = json.loads(line)
            if update["key"] != "learner":
                continue
            success = update["episodes"]["success"]
            built, ended = int(success["n_successes"]), int(success["n_episodes"])
            steps, seconds = int(update["n_env_steps"]), float(update.get("run_elapsed_s") or update["elapsed_s"])
        except (ValueError, KeyError, TypeError) as error:
            sys.exit(f"{path}:{number} is no line of metrics: {error!r}")
        window.append((built, ended))
        n_built, n_ended = n_built + built, n_ended + ended
        while n_ended - window[0][1] >= N_EPISODES:
            first = window.popleft()
            n_built, n_ended = n_built - first[0], n_ended - first[1]
        if n_ended > 0:
            moments.append(Moment(steps, seconds / 60, n_built / n_ended))
    return moments


def draw(picture: Path, curves: list[tuple[str, list[Moment]]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, both = pyplot.subplots(1, 2, figsize=(11, 4), sharey=True)
    names = list(dict.fromkeys(name for name, _ in curves))
    for axes, what in zip(both, ("environment steps", "minutes")):
        for i, (name, moments) in enumerate(curves):
            x = [moment.n_env_steps if what != "minutes" else moment.minutes for moment in moments]
            is_first = name not in (earlier for earlier, _ in curves[:i])
            color = f"C{names.index(name)}"
            axes.plot(x, [moment.success for moment in moments], color=color, label=name if is_first else None)
        axes.set_xlabel(what)
        axes.set_ylim(0.0, 1.02)
    both[0].set_ylabel(f"success of the last {N_EPISODES} episodes")
    both[0].legend()
    figure.savefig(picture, dpi=150, bbox_inches="tight")
    print(picture)


def main() -> None:
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    curves = []
    for argument in sys.argv[2:]:
        name, _, path = argument.rpartition("=")
        curves.append((name or Path(path).stem, curve(Path(path))))
    draw(Path(sys.argv[1]), curves)


if __name__ == "__main__":
    main()

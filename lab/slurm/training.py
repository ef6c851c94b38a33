"""A run on the test cluster, shared by the checks."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field

import queue_of_slurm as queue
from cluster import Cluster
from launched import Launched, partitions
from wait import wait_for

N_ACTORS = 3

NO_END = 1_000_000_000
"""Steps of a run that is stopped and does not end by itself."""


@dataclass
class Training:
    """A run and its cluster. Each check continues where the previous one ended."""

    cluster: Cluster
    run: Launched
    figures: dict[str, float] = field(default_factory=dict)
    returning: Future[float] | None = None
    """Seconds until the node that was mended last was in use again."""

    def options(self, n_steps: int = NO_END) -> list[str]:
        """Returns the launch options, without time limits."""
        learning = ["--preset", "near-goal", "--steps", str(n_steps), "--seed", "1"]
        return [*learning, "--actors", str(N_ACTORS), "--learner-cpus", "2", *partitions()]

    def learner_node(self) -> str:
        """Returns the node that the learner's job runs on."""
        return queue.job(self.run.learner_job())["NodeList"]

    def n_running(self) -> int:
        """Returns the number of actors that Slurm reports as running."""
        return len(queue.running(self.run.actor_job()))

    def wait_for_all_actors(self, limit_s: float) -> None:
        """Waits until every task of the array has a working actor."""

        def all_work() -> bool:
            return self.n_running() == N_ACTORS and len(self.run.actors_that_work()) == N_ACTORS

        wait_for(f"{N_ACTORS} actors work", all_work, limit_s)


Check = Callable[[Training], None]

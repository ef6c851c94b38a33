"""What the actors report on the bus, by process."""

from dataclasses import dataclass, field

from ..ring.bus import Listener, Report


@dataclass
class ActorLife:
    """The reports of one actor process."""

    actor: str
    epoch_ms: int
    last: Report
    n_reports: int = 1
    most_acked_between: int = 0
    """The most that were acknowledged between two reports."""
    going_back: list[str] = field(default_factory=list)

    @property
    def n_acked(self) -> int:
        """Trajectories that the learner acknowledged, as of the last report."""
        return int(self.last["n_trajectories_acked"])

    @property
    def n_dropped(self) -> int:
        """Trajectories that were dropped, without diverged episodes, which are never sent."""
        dropped: dict[str, int] = self.last["dropped"]
        return sum(n for reason, n in dropped.items() if reason != "diverged_total")

    def take(self, report: Report) -> None:
        """Processes the next report."""
        if report["elapsed_s"] <= self.last["elapsed_s"]:
            # What was published and what was asked for overlap after a reconnect.
            return
        for count in ("n_trajectories_acked", "n_env_steps", "n_episodes"):
            if report[count] < self.last[count]:
                self.going_back.append(f"{self.actor}: {count} fell from {self.last[count]} to {report[count]}")
        self.most_acked_between = max(self.most_acked_between, report["n_trajectories_acked"] - self.n_acked)
        self.last, self.n_reports = report, self.n_reports + 1


class Reports(Listener):
    """All actor processes that have reported, and the number of complete evaluations."""

    def __init__(self, port: int, run: str) -> None:
        super().__init__(port, run)
        self.actors: dict[tuple[str, int], ActorLife] = {}
        self.n_summaries = 0

    def digest(self) -> None:
        """Processes what came since the last call."""
        for key, report in self.take():
            if key == "eval/summary":
                self.n_summaries += bool(report["is_complete"])
            elif key.startswith("actor/"):
                name, epoch_ms = str(report["actor"]), int(report["epoch"])
                if life := self.actors.get((name, epoch_ms)):
                    life.take(report)
                else:
                    acked = int(report["n_trajectories_acked"])
                    self.actors[name, epoch_ms] = ActorLife(name, epoch_ms, report, most_acked_between=acked)

    def newest(self, actor: str) -> ActorLife | None:
        """Returns the newest process of an actor that has reported, or None."""
        lives = [life for (name, _), life in self.actors.items() if name == actor]
        return max(lives, key=lambda life: life.epoch_ms, default=None)

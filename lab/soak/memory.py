"""Checks that the memory of each role stays bounded."""

import time
from dataclasses import dataclass
from statistics import fmean, linear_regression

from ..ring.checks import require
from .members import Member

# Memory limit per role in megabytes: several times the observed usage.
LIMITS_MB = {"router": 256, "learner": 768, "actor": 256, "evaluator": 512}

# Time after the start in which a process fills its caches.
WARM_S = 20.0

LARGEST_SLOPE_MB_PER_MINUTE = 1.0


@dataclass
class Sample:
    """VmRSS of one process at one point in time."""

    pid: int
    age_s: float
    mb: float


def slope(samples: list[Sample]) -> float:
    """Returns the growth of warm processes in megabytes per minute, by least squares with an intercept per process.

    The separate intercepts keep one process's memory from counting as another's growth.
    """
    ages: list[float] = []
    sizes: list[float] = []
    for pid in {sample.pid for sample in samples}:
        own = [sample for sample in samples if sample.pid == pid and sample.age_s >= WARM_S]
        ages += [sample.age_s - fmean(one.age_s for one in own) for sample in own]
        sizes += [sample.mb - fmean(one.mb for one in own) for sample in own]
    return 60 * linear_regression(ages, sizes, proportional=True).slope if any(ages) else 0.0


class Memory:
    """Memory samples of all processes by role."""

    def __init__(self) -> None:
        self.samples: dict[str, list[Sample]] = {}
        self.calm_samples: dict[str, list[Sample]] = {}
        # Whether no fault is active. Growth is meaningful only then: a fault fills queues, and they keep their
        # capacity.
        self.is_calm = False

    def sample(self, member: Member) -> None:
        """Samples the newest process of a member."""
        kb = member.process.status("VmRSS") if member.processes else None
        if kb is not None:
            sample = Sample(member.process.pid, time.time() - member.process.began, kb / 1024)
            self.samples.setdefault(member.role, []).append(sample)
            if self.is_calm:
                self.calm_samples.setdefault(member.role, []).append(sample)

    def is_bounded(self) -> str:
        """Fails if a role exceeds its limit, or grows while no fault is active."""
        said = []
        for role, limit in LIMITS_MB.items():
            most, growth = max(sample.mb for sample in self.samples[role]), slope(self.calm_samples.get(role, []))
            require(most <= limit, f"{role} took {most:.0f} MB, more than {limit}")
            require(growth <= LARGEST_SLOPE_MB_PER_MINUTE, f"{role} grows by {growth:.2f} MB a minute")
            said.append(f"{role} {most:.0f} MB" + (f" ({growth:+.2f} a minute in the calm)" if self.calm_samples else ""))
        return ", ".join(said)

"""Checks that the memory of each role stays bounded."""

from __future__ import annotations

import time
from dataclasses import dataclass

from checks import require
from members import Member

# Memory limit per role in megabytes: several times the observed usage.
LIMITS_MB = {"router": 256, "learner": 768, "actor": 256, "evaluator": 512}

# Time after the start in which a process fills its caches.
WARM_S = 20.0

LARGEST_SLOPE_MB_PER_MINUTE = 1.0


@dataclass
class Sample:
    """VmRSS of one process at one point in time."""

    life: tuple[str, int]
    age_s: float
    mb: float


def slope(samples: list[Sample]) -> float:
    """Returns the growth of warm processes in megabytes per minute, by least squares with an intercept per process.

    The separate intercepts keep one process's memory from counting as another's growth.
    """
    above = below = 0.0
    for life in {sample.life for sample in samples}:
        own = [sample for sample in samples if sample.life == life and sample.age_s >= WARM_S]
        if len(own) < 2:
            continue
        mean_age = sum(sample.age_s for sample in own) / len(own)
        mean_mb = sum(sample.mb for sample in own) / len(own)
        above += sum((sample.age_s - mean_age) * (sample.mb - mean_mb) for sample in own)
        below += sum((sample.age_s - mean_age) ** 2 for sample in own)
    return 60 * above / below if below else 0.0


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
        kb = member.resident_kb() if member.lives else None
        if kb is not None:
            age = time.time() - member.life.began
            sample = Sample((member.name, member.life.number), age, kb / 1024)
            self.samples.setdefault(member.role, []).append(sample)
            if self.is_calm:
                self.calm_samples.setdefault(member.role, []).append(sample)

    def most_mb(self, role: str) -> float:
        """Returns the largest sample of a role."""
        return max(sample.mb for sample in self.samples[role])

    def slopes_mb_per_minute(self) -> dict[str, float]:
        """Returns the growth rate of each role's processes in the calm phase, if there is one."""
        return {role: slope(samples) for role, samples in self.calm_samples.items()}

    def is_bounded(self) -> str:
        """Fails if a role exceeds its limit, or grows while no fault is active."""
        said = []
        slopes = self.slopes_mb_per_minute()
        for role, limit in LIMITS_MB.items():
            most, growth = self.most_mb(role), slopes.get(role)
            require(most <= limit, f"{role} took {most:.0f} MB, more than {limit}")
            if growth is None:
                said.append(f"{role} {most:.0f} MB")
                continue
            require(growth <= LARGEST_SLOPE_MB_PER_MINUTE, f"{role} grows by {growth:.2f} MB a minute")
            said.append(f"{role} {most:.0f} MB ({growth:+.2f} a minute in the calm)")
        return ", ".join(said)

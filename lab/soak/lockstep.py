"""Checks that `train --lockstep`, killed at random and resumed, ends with the same bytes as an undisturbed run."""

import asyncio
import random
from pathlib import Path

from ..ring import records
from ..ring.checks import eventually, require
from ..ring.processes import settings
from .members import SMALL_UPDATES, Member

STEPS = 8192

SETTINGS: dict[str, object] = {
    **SMALL_UPDATES,
    "actor.n_worlds": 4,
    "actor.segment_len": 16,
    "evaluator.every.versions": 1_000_000,
    "evaluator.episodes.n_episodes": 1,
    "evaluator.videos.groups": [],
}

LIMIT_S = 300.0

# Longest delay between reaching a step count and the kill, in seconds: longer than an update with its save.
DELAY_S = 0.5


class Training:
    """A run that resumes when it is started again."""

    def __init__(self, binary: Path, folder: Path, name: str, seed: int) -> None:
        self.folder = folder / name
        task = ["train", "--preset", "smoke", "--lockstep", "--seed", str(seed), "--steps", str(STEPS)]
        command = [str(binary), *task, *settings(SETTINGS), "--run-dir", str(self.folder), "--auto-resume"]
        self.member = Member(name, "train", command, folder / "logs")

    async def run(self, moments: list[int], chance: random.Random) -> list[int]:
        """Runs to the end with a kill -9 soon after each step count in `moments`. Returns the steps resumed from."""
        member, began = self.member, []
        member.start()
        for moment in moments:

            def has_come_to() -> bool:
                return records.saved_steps(self.folder) >= moment or member.has_ended()

            await eventually(f"{member.name} has {moment} steps", LIMIT_S, has_come_to, 0.005)
            await asyncio.sleep(chance.uniform(0, DELAY_S))
            if member.has_ended():
                break
            await member.kill()
            began.append(records.saved_steps(self.folder))
            member.start()
        await eventually(f"{member.name} reaches its steps", LIMIT_S, member.has_ended)
        code = member.process.code
        require(code == 0, f"{member.name} ended with {code}, see {member.process.log}")
        return began


async def ends_with_the_same_bytes(binary: Path, folder: Path, seed: int, n_kills: int) -> str:
    """Compares the parameters and optimizer states of the two runs."""
    chance = random.Random(seed)
    # The first kill comes before any checkpoint exists, so the run starts over.
    moments = [0, *sorted(chance.sample(range(256, STEPS * 3 // 4), n_kills - 1))]
    calm, killed = (Training(binary, folder, name, seed) for name in ("undisturbed", "killed"))
    try:
        await calm.run([], chance)
        began = await killed.run(moments, chance)
    finally:
        for process in (*calm.member.processes, *killed.member.processes):
            process.kill()
    require(len(began) >= min(2, n_kills), f"only {len(began)} kills before the run had ended")
    (steps, expected), (n, found) = (records.checkpoints_are_whole(run.folder).popitem() for run in (calm, killed))
    require(steps == n, f"they end with {steps} and {n} steps")
    for name in ("parameters.safetensors", "adam.safetensors"):
        same = (expected / name).read_bytes() == (found / name).read_bytes()
        require(same, f"{name} differs after kills and going on from {began} steps (seed {seed})")
    return f"{expected.name}, killed {len(began)} times, went on from {began} steps"

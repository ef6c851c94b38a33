"""Checks that `train --lockstep`, killed at random and resumed, ends with the same bytes as an undisturbed run."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from pathlib import Path

import records
from checks import Failed, require, until
from members import Member
from ring import settings

STEPS = 8192

SETTINGS = {
    "learner.steps_per_update": "256",
    "learner.minibatch_size": "128",
    "learner.mailbox.capacity_steps": "256",
    "learner.checkpoints.every_updates": "2",
    "actor.n_worlds": "4",
    "actor.segment_len": "16",
    "evaluator.every.versions": "1000000",
    "evaluator.episodes.n_episodes": "1",
    "evaluator.films.groups": "[]",
}

LIMIT_S = 300.0

# Longest delay between reaching a step count and the kill, in seconds: longer than an update with its save.
DELAY_S = 0.5


def trainer(binary: Path, folder: Path, name: str, seed: int) -> Member:
    """Returns a run that resumes automatically when restarted."""
    command = [str(binary), "train", "--preset", "near-goal", "--lockstep", "--seed", str(seed), "--steps", str(STEPS)]
    command += [*settings(SETTINGS), "--run-dir", str(folder / name), "--auto-resume"]
    return Member(name, "train", command, folder / "logs", None)


async def finish(run: Member) -> None:
    """Waits until the run has reached its steps."""
    await until(f"{run.name} reaches its steps", LIMIT_S, lambda: run.poll() is not None)
    require(run.poll() == 0, f"{run.name} ended with {run.poll()}, see {run.life.log}")


def last_checkpoint(folder: Path) -> Path:
    """Returns the newest checkpoint of a run."""
    saved = records.checkpoints(folder)
    require(saved, f"{folder} has no checkpoint")
    return saved.popitem()[1]


def has_come_to(run: Member, folder: Path, moment: int) -> Callable[[], bool]:
    """Returns a condition: the run has a checkpoint with at least `moment` steps, or has ended."""
    return lambda: max(records.checkpoints(folder), default=0) >= moment or run.poll() is not None


async def disturbed(run: Member, folder: Path, moments: list[int], chance: random.Random) -> list[int]:
    """Runs to the end with a kill -9 soon after each step count in `moments`. Returns the steps resumed from."""
    began = []
    run.start()
    for moment in moments:
        await until(f"{run.name} has {moment} steps", LIMIT_S, has_come_to(run, folder, moment), 0.005)
        await asyncio.sleep(chance.uniform(0, DELAY_S))
        if run.poll() is not None:
            break
        await run.kill()
        began.append(max(records.checkpoints(folder), default=0))
        run.start()
    await finish(run)
    return began


async def ends_with_the_same_bytes(binary: Path, folder: Path, seed: int, n_kills: int) -> str:
    """Compares the parameters and optimizer states of the two runs."""
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    chance = random.Random(seed)
    # The first kill comes before any checkpoint exists, so the run starts over.
    moments = [0, *sorted(chance.sample(range(256, STEPS * 3 // 4), n_kills - 1))]
    calm, killed = (trainer(binary, folder, name, seed) for name in ("undisturbed", "killed"))
    try:
        calm.start()
        await finish(calm)
        began = await disturbed(killed, folder / "killed", moments, chance)
    finally:
        calm.end_now()
        killed.end_now()
    require(len(began) >= min(2, n_kills), f"only {len(began)} kills before the run had ended")
    expected, found = (last_checkpoint(folder / run.name) for run in (calm, killed))
    require(expected.name == found.name, f"they end with {expected.name} and {found.name}")
    for name in ("parameters.safetensors", "adam.safetensors"):
        if (expected / name).read_bytes() != (found / name).read_bytes():
            raise Failed(f"{name} differs after kills and going on from {began} steps (seed {seed})")
    return f"{expected.name}, killed {len(began)} times, went on from {began} steps"

"""Records episodes as a Minari dataset for offline learning.

    pip install "minari[arrow]" pillow
    python -m lodestone.record --blueprint 4_000 --episodes 20
    python -c 'import minari; print(minari.load_dataset("lodestone/expert-v0"))'

Minari keeps datasets in ~/.minari/datasets, or in MINARI_DATASETS_PATH if set. The function `record` records any agent.
"""

from __future__ import annotations

import argparse
import copy
import importlib.metadata
import json
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import DependencyNotInstalled

from lodestone import ENV_ID, checks
from lodestone.agents import Expert, Policy
from lodestone.batch import REWARD_TERMS
from lodestone.env import AssemblyEnv

if TYPE_CHECKING:
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer

# The names that Minari accepts. It creates folders before it checks a name.
_NAME = re.compile(r"([\w-][\w/-]*[\w-]/)?[\w-]+-v\d+", re.ASCII)


def record(
    env: gymnasium.Env[Any, Any],
    agent: Any,
    name: str,
    *,
    episodes: int = 10,
    seed: int = 0,
    deterministic: bool = True,
    **about: Any,
) -> MinariDataset:
    """Records episodes of each blueprint of an environment and writes each one when it ends.

    Diverged episodes are left out. After Ctrl-C, the dataset holds the episodes recorded so far.

    The spaces are those of the environment. `infos` has the `blueprint`, and `is_success` and `reward_terms` as `step`
    returns them. The metadata of an episode has the `seed` and `options` of its reset, its `start`, and `is_success`.
    `dataset.recover_environment()` makes the environment again, without the files that it was made from. After a reset
    with the same seed and options, the recorded actions lead to the recorded observations.

    Args:
        env: What `gymnasium.make("Lodestone/Assembly-v0", ...)` returned.
        agent: An `Expert`, a `Policy`, or another object whose method `act(env)` returns an action.
        name: Name of the dataset, such as `lodestone/expert-v0`.
        episodes: Episodes per blueprint.
        seed: Seed of the first episode, and of a policy's samples. The seed grows by one from episode to episode.
        deterministic: Whether a policy acts greedily instead of sampling its actions.
        **about: Metadata for `minari.create_dataset_from_buffers`, such as `algorithm_name` and `code_permalink`.
    """
    if not isinstance(getattr(env, "unwrapped", None), AssemblyEnv) or env.spec is None:
        raise checks.refusal("env", env, f"an environment that gymnasium.make made from {ENV_ID}")
    if not callable(getattr(agent, "act", None)):
        raise checks.refusal("agent", agent, "an object whose method act(env) returns an action")
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise checks.refusal("name", name, "letters, digits, - and _, and a version, as in lodestone/expert-v0")
    episodes, seed = checks.whole("episodes", episodes, 1), checks.whole("seed", seed, 0, 2**63)
    if not checks.flag("deterministic", deterministic) and not isinstance(agent, Policy):
        raise checks.refusal("deterministic", deterministic, "True if the agent is no Policy")
    act, origin = agent.act, {"lodestone_version": importlib.metadata.version("lodestone-assembly"), "seed": seed}
    if isinstance(agent, Policy):
        agent.seed(seed)
        act = partial(act, deterministic=deterministic)
        origin |= {"weights_version": agent.version, "deterministic": deterministic}
    dataset = _created(env, name, about)
    dataset.storage.update_metadata({"lodestone": origin})
    for number, blueprint in enumerate(env.unwrapped.batch.worlds.blueprints * episodes):
        episode = _played(env, act, seed + number, {"blueprint": blueprint})
        if episode is None:
            continue
        start = env.unwrapped.batch.about(0)["start"]
        with _interrupts_held_back():
            dataset.update_dataset_from_buffer([episode])
            told = {"start": start, "is_success": episode.terminations[-1]}
            dataset.storage.update_episode_metadata([told], dataset.episode_indices[-1:])
    return dataset


def _created(env: gymnasium.Env[Any, Any], name: str, about: Mapping[str, Any]) -> MinariDataset:
    """Creates a dataset without episodes."""
    try:
        import minari
        import PIL  # noqa: F401, Minari's storage needs it
        import pyarrow  # noqa: F401, as above
    except ImportError as error:
        raise DependencyNotInstalled('a dataset needs Minari: pip install "minari[arrow]" pillow') from error
    with warnings.catch_warnings():
        # Minari warns of all metadata that `about` lacks, and makes another environment, which repeats the warnings of
        # this one.
        warnings.simplefilter("ignore", UserWarning)
        return minari.create_dataset_from_buffers(name, [], _portable(env), data_format="arrow", **about)


def _portable(env: gymnasium.Env[Any, Any]) -> EnvSpec:
    """Returns the specification of an environment with all settings, and with texts in place of paths."""
    _, names, starts, _, settings, features, _ = env.unwrapped.batch.worlds.__reduce__()[1]
    spec = copy.deepcopy(env.spec)
    spec.kwargs |= {"blueprint": names, "starts": dict(starts)}
    spec.kwargs |= {"settings": json.loads(settings), "features": json.loads(features)}
    return spec


def _played(
    env: gymnasium.Env[Any, Any], act: Callable[[Any], Any], seed: int, options: dict[str, str]
) -> EpisodeBuffer | None:
    """Plays an episode; returns None if it diverged."""
    from minari.data_collector import EpisodeBuffer

    observation, _ = env.reset(seed=seed, options=options)
    observations, actions, rewards, is_success = [observation], [], [], [False]
    reward_terms = [np.zeros(len(REWARD_TERMS), np.float32)]
    terminated = truncated = False
    while not (terminated or truncated):
        actions.append(act(env))
        observation, reward, terminated, truncated, info = env.step(actions[-1])
        observations.append(observation)
        rewards.append(reward)
        is_success.append(info["is_success"])
        reward_terms.append(info["reward_terms"])
    if info["diverged"]:
        return None
    n_steps = len(rewards)
    running = [False] * (n_steps - 1)
    return EpisodeBuffer(
        seed=seed,
        options=options,
        observations=_columns(observations),
        actions=_columns(actions),
        rewards=rewards,
        terminations=[*running, terminated],
        truncations=[*running, truncated],
        infos={
            "blueprint": [options["blueprint"]] * (n_steps + 1),
            "is_success": is_success,
            "reward_terms": np.stack(reward_terms),
        },
    )


def _columns(rows: list[Any]) -> Any:
    """Stacks observations or actions, or each of their parts."""
    if isinstance(rows[0], dict):
        return {name: np.stack([row[name] for row in rows]) for name in rows[0]}
    return np.stack(rows)


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Lets Ctrl-C wait until the block ends, because it would leave a file half written."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: waiting.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if waiting:
            signal.raise_signal(signal.SIGINT)


def main() -> int:
    """Records what the command line asks for; returns the exit code."""
    parser = argparse.ArgumentParser(
        "python -m lodestone.record", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--agent", default="expert", help="expert (the default), pretrained, or a file written by lodestone export")
    add("--sampled", action="store_true", help="sample the policy's actions instead of acting greedily")
    add("--blueprint", nargs="+", default=["4_000"], help="ids, splits, and paths of TOML files; 4_000 by default")
    add("--starts", default="scattered", help="scattered (the default), prebuilt, near-goal:N, ...")
    add("--settings", metavar="FILE", help="configuration of the world, such as a run's config.toml")
    add("--episodes", type=int, default=10, metavar="N", help="episodes per blueprint; 10 by default")
    add("--seed", type=int, default=0, metavar="S", help="seed of the first episode and of samples; 0 by default")
    add("--name", help="name of the dataset; lodestone/AGENT-v0 or lodestone/AGENT-sampled-v0 by default")
    args = parser.parse_args()
    if args.sampled and args.agent == "expert":
        parser.error("--sampled is for a policy: the expert has nothing to sample")
    algorithm = re.sub(r"[^A-Za-z0-9_-]", "-", Path(args.agent).stem)
    name = args.name or f"lodestone/{algorithm}{'-sampled' if args.sampled else ''}-v0"
    try:
        agent, env = _agent_and_env(args)
        about = {"algorithm_name": algorithm, "description": f"{algorithm} assembles magnet blocks into blueprints."}
        options = {"episodes": args.episodes, "seed": args.seed, "deterministic": not args.sampled}
        dataset = record(env, agent, name, **options, **about)
    except (DependencyNotInstalled, OSError, ValueError) as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        print(f"interrupted; {name} holds the episodes recorded so far", file=sys.stderr)
        return 130
    told = dataset.storage.get_episode_metadata(dataset.episode_indices)
    n_built = sum(episode["is_success"] for episode in told)
    print(f"{name}: {dataset.total_episodes} episodes, {dataset.total_steps} steps, {n_built} built")
    return 0


def _agent_and_env(args: argparse.Namespace) -> tuple[Expert | Policy, gymnasium.Env[Any, Any]]:
    """Returns the agent, and a world in which it can act, with the features that it sees."""
    world = {"blueprint": args.blueprint, "starts": args.starts, "settings": args.settings}
    if args.agent == "expert":
        return Expert(), gymnasium.make(ENV_ID, **world)
    agent = Policy.pretrained() if args.agent == "pretrained" else Policy.load(args.agent)
    world["settings"] = args.settings or {"n_grippers": agent.native.n_grippers}
    return agent, gymnasium.make(ENV_ID, features=agent.features, **world)


if __name__ == "__main__":
    sys.exit(main())

"""Batches of worlds and the policy, in Rust. `lodestone.batch` and `lodestone.agents` are what to use instead.

Arrays are C-contiguous. `n` is the number of worlds, `g` the number of grippers. Whatever is wrong with an argument raises
ValueError, or TypeError for a value or an array of another type or layout, and leaves the worlds as they are. A world that
cannot start an episode raises ValueError as well, after all the others have started or stepped.
"""

from collections.abc import Sequence
from os import PathLike
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__all__ = ["Policy", "Worlds", "blueprints"]

def blueprints(names: Sequence[str]) -> list[tuple[str, int]]:
    """Ids and numbers of blocks of what the names name: ids, splits, and paths of TOML files or of folders with such files.

    A UserWarning says of each block that could lie in several ways which one was taken.
    """

@final
class Worlds:
    """`n` worlds that step side by side on up to `n_threads` threads, without the global interpreter lock.

    A deep copy goes on bit for bit. A pickle holds the arguments, with the texts of blueprints in place of paths, and for
    each world its generator and its tasks and actions since the last start other than as-it-is. Unpickling replays them. It
    raises ValueError if they do not lead to the same state, as on a machine that computes differently. MemoryError if
    there is no memory for all worlds.
    """

    def __new__(
        cls,
        n: int,
        blueprints: Sequence[str],
        starts: Sequence[tuple[str, float]],
        shuffle_blocks: bool,
        settings: str,
        features: str,
        n_threads: int,
    ) -> Worlds:
        """`settings` is the section `[environment]` of a configuration as JSON, `features` the section `[policy.features]`.

        Warns as `blueprints` does.
        """

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of features of a node (nd), of an edge (ed), and of the whole scene (gd)."""

    @property
    def features(self) -> str:
        """What is seen: the section `[policy.features]` as JSON."""

    @property
    def n_grippers(self) -> int:
        """1 or 2."""

    @property
    def episode_steps(self) -> int:
        """Steps before an episode ends at the time limit."""

    @property
    def step_s(self) -> float:
        """Length of a step in seconds."""

    @property
    def blueprints(self) -> list[str]:
        """Ids of the goals that are drawn."""

    def reset(
        self,
        mask: NDArray[np.bool_],
        seeds: Sequence[int | None],
        blueprint: str | None,
        start: str | None,
        features: Sequence[NDArray[np.float32]],
    ) -> None:
        """Starts episodes in the worlds of `mask` and writes their rows of `features`.

        A seed, if there is one for a world, determines its episodes from here on. `features` is one array with
        n × (16 nd + 240 ed + gd) entries, or three with n × 16 nd, n × 240 ed, and n × gd.
        """

    def step(
        self,
        choices: NDArray[np.int64],
        moves: NDArray[np.float32],
        resets: NDArray[np.bool_],
        features: Sequence[NDArray[np.float32]],
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float32]]:
        """Moves each world by one step, but starts an episode in those of `resets`; writes all features.

        `choices` is [n, g], blocks from 0 to 15; `moves` is [n, 16, 6], fractions of the speed limits. Returns rewards [n],
        statuses [n] (0 running, 1 success, 2 time limit, 3 diverged), and the terms of the rewards [n, 5].
        """

    def observe(self, settings: str, features: Sequence[NDArray[np.float32]]) -> None:
        """Writes the features that other `[policy.features]`, as JSON, give."""

    def episode(self, row: int) -> tuple[str, str, int]:
        """The goal of a world's episode, how it began, and the seed of its start. IndexError if there is none."""

    def allowed(self) -> NDArray[np.bool_]:
        """Whether a masked gripper may choose a block [n, 16]: those of the blueprint and those with a connection."""

    def proposals(self) -> tuple[NDArray[np.bool_], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """The proposals of each world: offered [n, 16, 33], moves [n, 16, 33, 6], noise [n, 16, 33], relations [n, 16, 16, 8].

        After a divergence, those of the episode's start.
        """

    def offered(self, is_masked: bool) -> NDArray[np.bool_]:
        """Whether a pick is offered [n, 528]: with `is_masked`, only those of allowed blocks."""

    def picked(
        self, picks: NDArray[np.int64], skipped: NDArray[np.bool_], is_noisy: bool, is_masked: bool
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The actions of picks [n, g], as choices [n, g] and moves [n, 16, 6].

        Their noise is drawn from each world's own generator, but not in worlds of `skipped` [n], which do not act.
        """

    def expert(self) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """What the scripted expert does in each world: choices [n, g] and moves [n, 16, 6]."""

    def scene(self, row: int) -> dict[str, Any]:
        """The state of a world; `lodestone.AssemblyEnv.scene` says what is in it."""

    def set_scene(
        self,
        row: int,
        positions: NDArray[np.float32],
        orientations: NDArray[np.float32],
        connections: Sequence[tuple[int, int]],
    ) -> None:
        """Begins a world's episode anew with blocks at rest: positions [16, 3], quaternions [16, 4], and connected pairs."""

    def picture(self, row: int, width: int, height: int) -> NDArray[np.uint8]:
        """A picture of a world and its goal, [height, width, 3]; sides are 32 to 4096 pixels."""

@final
class Policy:
    """A frozen policy on the CPU. A copy or a pickle holds the file and goes on with the same sampled actions."""

    def __new__(cls, file: bytes, seed: int = 0, positions: Sequence[int] = ()) -> Policy:
        """The policy in a file, with the positions of its generators, one for each row."""

    @staticmethod
    def pretrained() -> Policy:
        """The policy that comes with the program."""

    @staticmethod
    def load(path: str | PathLike[str]) -> Policy:
        """The policy in a file of `lodestone export`. OSError if it cannot be read."""

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of features of a node (nd), of an edge (ed), and of the whole scene (gd)."""

    @property
    def n_grippers(self) -> int:
        """1 or 2."""

    @property
    def features(self) -> str:
        """What it sees: the section `[policy.features]` as JSON."""

    @property
    def is_mixture(self) -> bool:
        """Whether it draws moves from proposals."""

    @property
    def version(self) -> int:
        """Version of its weights."""

    def seed(self, seed: int) -> None:
        """Draws sampled actions by this seed from now on."""

    def act(
        self,
        nodes: NDArray[np.float32],
        edges: NDArray[np.float32],
        globals: NDArray[np.float32],
        sampled: bool,
        worlds: Worlds | None = None,
    ) -> tuple[
        tuple[NDArray[np.int64], NDArray[np.float32]], NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]
    ]:
        """Acts on features [n, 16, nd], [n, 240, ed], [n, gd]; a mixture also on the proposals of the `n` worlds.

        Returns choices [n, g] and moves [n, 16, 6], their log-probabilities [n] in nats, values [n] as returns, and the
        slots of the proposals [n, g], -1 where there are none. A mixture without worlds raises ValueError.
        """

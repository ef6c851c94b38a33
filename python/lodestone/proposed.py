"""The proposals of scenes: the moves from which the mixture head draws."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodestone.agents import Target
from lodestone.batch import N_BLOCKS, N_SLOTS

KINDS = ("join", "detach", "hold")


def proposals(env: Any) -> dict[str, NDArray[Any]]:
    """Returns the moves that make sense in the present scene of an environment of this package.

    Every block has 33 slots, some of which are offered. policy/src/proposals.rs says what each kind does, and when it
    is offered. A batch of worlds puts its axis `[num_envs]` in front of the first four arrays.

    | array | shape, type | meaning |
    |---|---|---|
    | `offered` | [16, 33] bool | whether the block has a proposal in the slot |
    | `moves` | [16, 33, 6] float32 | its linear and angular velocity in the block's own frame, fractions of the limits \
3 m/s and 2π rad/s, -1 to 1; 0 where nothing is offered |
    | `noise` | [16, 33] float32 | standard deviation of each of the six entries, in the same units |
    | `relations` | [16, 16, 8] float32 | what the first block is to the second, 0 to 1; all 0 on the diagonal |
    | `kinds` | [33] int64 | what the slot does, an index of `lodestone.proposed.KINDS` |
    | `partners` | [33] int64 | the other block of `join` and `detach`, 0 to 15; -1 for `hold` |

    The entries of a relation: to be connected, and in different pieces; in one piece; connected, correctly or not; a
    gripper holds the second; exp(-n / 2) with the n steps to the first's place; exp(-3 d) with the larger of lateral
    distance and turn, in steps; to be connected, in one piece, and not connected; connected, but wrongly. The two with
    exp are 0 unless the two are to be connected and are not correctly connected.

    Slot s of block i is the pick i · 33 + s of an environment with `action="proposals"`.
    """
    target = Target(env)
    names = ("offered", "moves", "noise", "relations")
    arrays = dict(zip(names, target.batch.worlds.proposals(), strict=True))
    made: dict[str, NDArray[Any]] = arrays if hasattr(target.env, "num_envs") else {k: x[0] for k, x in arrays.items()}
    made["kinds"] = np.arange(N_SLOTS) // N_BLOCKS
    made["partners"] = np.r_[np.tile(np.arange(N_BLOCKS), 2), -1]
    return made

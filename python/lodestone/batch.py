"""Batches of native worlds with the spaces for Gymnasium, PettingZoo, and Stable-Baselines3."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict

import numpy as np
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError
from numpy.typing import NDArray

from lodestone import _native, checks
from lodestone.checks import refusal

Names: TypeAlias = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
Starts: TypeAlias = str | Mapping[str, float]
Settings: TypeAlias = Mapping[str, Any] | str | os.PathLike[str] | None
Features: TypeAlias = Literal["all", "paper"] | Mapping[str, bool]
Observation: TypeAlias = dict[str, NDArray[np.float32]] | NDArray[np.float32]
Action: TypeAlias = dict[str, NDArray[Any]] | NDArray[np.float32] | NDArray[np.int64]

N_BLOCKS, N_EDGES, N_MOVES = 16, 240, 6
# Flat action entries per gripper: a score for each block, then the move of the block with the highest score.
N_FLAT = N_BLOCKS + N_MOVES
# Slots of a block's proposals: 16 joins and 16 detachments, by partner, and a hold.
N_SLOTS = 2 * N_BLOCKS + 1
# Picks of a gripper: block · 33 + slot.
N_PICKS = N_BLOCKS * N_SLOTS
# Limits of a batch. A world takes up to 0.4 MB, and its part of a vector environment's spaces and observations 0.15 MB.
MAX_WORLDS, MAX_THREADS = 16_384, 1024
REWARD_TERMS = ("connected", "wrong", "magnets", "blocks", "force")
# Bound of every feature. Only a diverged world exceeds it, and its features are clipped.
MAX_FEATURE = 256.0
SUCCESS, TIME_LIMIT, DIVERGED = 1, 2, 3
# Named feature sets. The flags are those of `[policy.features]` in a configuration, where all are on by default.
FEATURES: dict[str, dict[str, bool]] = {
    "all": {},
    "paper": {"up_axis": False, "membership": False, "block_shape": False, "needed_moves": False},
}


class Options(TypedDict, total=False):
    """Options of `reset` that replace random draws."""

    blueprint: str
    start: str


def names_of(blueprint: Names) -> list[str]:
    """Converts a blueprint argument to a list of strings."""
    expected = "an id, a split, a path, the text of a TOML file, or a list of these"
    if isinstance(blueprint, (str, os.PathLike)):
        return [_name_of("blueprint", blueprint, expected)]
    blueprint = blueprint.tolist() if isinstance(blueprint, np.ndarray) else blueprint
    if not isinstance(blueprint, Iterable) or isinstance(blueprint, (bytes, bytearray, Mapping)):
        raise refusal("blueprint", blueprint, expected)
    names = [_name_of(f"blueprint[{at}]", name, expected) for at, name in enumerate(blueprint)]
    if not names:
        raise refusal("blueprint", blueprint, "at least one blueprint")
    return names


def _name_of(name: str, blueprint: Any, expected: str) -> str:
    if isinstance(blueprint, os.PathLike):
        # The string `train` is the split, but a path object is always a path. The prefix `./` makes that explicit.
        return os.path.join(os.curdir, checks.text(name, os.fspath(blueprint), expected))
    return checks.text(name, blueprint, expected)


def blueprints(blueprint: Names = "train") -> dict[str, int]:
    """Returns the block counts of blueprints by id.

    `blueprint` is an id from the catalog (`4_000`), a split (`train`, `test`, `test-literal`, `test-longest`,
    `test-tallest`, `validation`), the path of a TOML file or a folder of TOML files, the contents of a TOML file, or a
    list of any of these. A string that contains `/` or ends in `.toml` is a path. Any other string is a path only if it
    is neither a split nor an id. If a block in a file fits in several orientations, a UserWarning reports the one
    used.
    """
    return dict(_native.blueprints(names_of(blueprint)))


def read_settings(settings: Settings) -> str:
    """Returns the section `[environment]` as JSON. A path names a configuration file, such as a run's `config.toml`.

    Raises ValueError if the file cannot be read, is not TOML, or is based on a preset.
    """
    if settings is None:
        return "{}"
    if isinstance(settings, Mapping):
        return _json("settings", settings)
    expected = "a dictionary of settings of [environment], the path of a configuration file, or None"
    path = checks.text("settings", os.fspath(settings) if isinstance(settings, os.PathLike) else settings, expected)
    try:
        keys = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"settings: cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise ValueError(f"settings: {path} is not TOML: {error}") from error
    # Only the command-line program has presets. `none` means the defaults, which apply here too.
    base = keys.get("base", "none")
    if base != "none":
        raise ValueError(
            f"settings: {path} has base = {base!r}, a preset that this package does not read: "
            "give the config.toml of a run, which has all settings"
        )
    return _json(f"settings: {path}: environment", keys.get("environment", {}))


def read_features(features: Features) -> str:
    """Returns the section `[policy.features]` as JSON."""
    if isinstance(features, Mapping):
        return _json("features", features)
    checks.one_of("features", features, FEATURES, ", or a dictionary of flags")
    return json.dumps(FEATURES[features])


def read_starts(starts: Starts) -> list[tuple[str, float]]:
    """Returns the starts with their weights."""
    expected = "the name of a start, or a dictionary of weights by name"
    if isinstance(starts, str):
        return [(checks.text("starts", starts, expected), 1.0)]
    if not isinstance(starts, Mapping):
        raise refusal("starts", starts, expected)
    for start, weight in checks.mapping("starts", starts).items():
        if isinstance(weight, (bool, np.bool_)) or not isinstance(weight, (int, float, np.number)):
            raise refusal(f"starts[{start!r}]", weight, "a finite number that is not negative")
    return [(start, float(weight)) for start, weight in starts.items()]


class Batch:
    """A batch of worlds with observation and action spaces, and conversions to and from the native module's arrays.

    The environments are built on it and check what goes to its methods. After `close`, using its worlds raises
    Gymnasium's `ClosedEnvironmentError`.

    Args:
        n: Number of worlds, up to 16,384. MemoryError if there is no memory for them.
        blueprint: The goals, as for `lodestone.blueprints`. Each entry is equally likely.
        starts: How episodes start: `scattered`, `prebuilt` (another training blueprint is built), `prebuilt:ID` (from
            the catalog or a file in `blueprint`), `near-goal` (the goal is built except for one or two
            blocks), `near-goal:N`, `near-goal:M-N`, or `as-it-is` (the world stays as the last episode left it). Or a
            mapping of these to weights.
        shuffle_blocks: Whether equal blocks swap roles from episode to episode.
        settings: Settings of the world, such as `{"physics": {"friction": 0.4}}`, or the path of a configuration file.
        features: Observed features: `all` (every one that a policy can use, as for the pretrained policy), `paper`
            (those of the paper), or flags by name.
        observation: `features` for a dictionary of `nodes` [16, nd], `edges` [240, ed], and `globals` [gd], or `flat`
            for their concatenation.
        action: `native` for a dictionary of `choices` [grippers], the block that each gripper moves, and `moves`
            [16, 6], the linear and angular velocity of each block in its own frame as fractions of the speed limits.
            Only the moves of chosen blocks count. Or `flat` for 22 numbers in [-1, 1] per gripper: a score for each
            block, and the move of the block with the highest score. If two grippers choose the same block, it moves by
            the mean of their moves. Or `proposals` for a number from 0 to 527 per gripper, block · 33 + slot: which of
            its proposals (`lodestone.proposals`) moves which block. A pick that is not offered leaves its block where
            it is, and of two on the same block the first counts. `action_masks()` tells what is offered. `Expert` and
            `Policy` cannot act in such an environment.
        mask: With `blueprint`, the scores of flat actions and the picks among proposals choose only among the
            blueprint's blocks and connected blocks, like `mask` in `[policy]`. Where `Expert` or a policy chooses
            another block, nothing moves. With `none`, they choose among all blocks.
        noise: Whether picked proposals have their noise, drawn from each world's own generator, which `reset` seeds.
        num_threads: Threads that step worlds, up to 1024; by default the number of processors, but at most `n`.
    """

    def __init__(
        self,
        n: int,
        *,
        blueprint: Names = "train",
        starts: Starts = "scattered",
        shuffle_blocks: bool = True,
        settings: Settings = None,
        features: Features = "all",
        observation: Literal["features", "flat"] = "features",
        action: Literal["native", "flat", "proposals"] = "native",
        mask: Literal["none", "blueprint"] = "none",
        noise: bool = True,
        num_threads: int | None = None,
    ) -> None:
        checks.one_of("observation", observation, ("features", "flat"))
        checks.one_of("action", action, ("native", "flat", "proposals"))
        checks.one_of("mask", mask, ("none", "blueprint"))
        if mask == "blueprint" and action == "native":
            raise ValueError("mask 'blueprint' is for flat actions and proposals: a native action names its blocks")
        self.n = n = checks.whole("n", n, 1, MAX_WORLDS)
        self.flat_observation, self.flat_action = observation == "flat", action == "flat"
        self.picks, self.noise = action == "proposals", checks.flag("noise", noise)
        self.masked = mask == "blueprint"
        self.features = read_features(features)
        threads = min(n, os.cpu_count() or 1)
        if num_threads is not None:
            threads = checks.whole("num_threads", num_threads, 1, MAX_THREADS, ", or None")
        self._worlds: _native.Worlds | None = _native.Worlds(
            n,
            names_of(blueprint),
            read_starts(starts),
            checks.flag("shuffle_blocks", shuffle_blocks),
            read_settings(settings),
            self.features,
            threads,
        )
        self.n_grippers = self.worlds.n_grippers

        nd, ed, gd = self.worlds.sizes
        self.shapes = {"nodes": (N_BLOCKS, nd), "edges": (N_EDGES, ed), "globals": (gd,)}
        if self.flat_observation:
            total = sum(int(np.prod(shape)) for shape in self.shapes.values())
            self.observation_space: spaces.Space[Any] = _box(MAX_FEATURE, (total,))
        else:
            self.observation_space = spaces.Dict(
                {name: _box(MAX_FEATURE, shape) for name, shape in self.shapes.items()}
            )
        if self.flat_action:
            self.action_space: spaces.Space[Any] = _box(1.0, (self.n_grippers * N_FLAT,))
        elif self.picks:
            self.action_space = spaces.MultiDiscrete([N_PICKS] * self.n_grippers)
        else:
            choices = spaces.MultiDiscrete([N_BLOCKS] * self.n_grippers)
            self.action_space = spaces.Dict({"choices": choices, "moves": _box(1.0, (N_BLOCKS, N_MOVES))})

    @property
    def worlds(self) -> _native.Worlds:
        """The worlds. Raises ClosedEnvironmentError after `close`."""
        if self._worlds is None:
            raise ClosedEnvironmentError("the environment is closed: make a new one")
        return self._worlds

    def check_open(self) -> None:
        """Raises ClosedEnvironmentError after `close`."""
        _ = self.worlds

    def close(self) -> None:
        """Gives the worlds up."""
        self._worlds = None

    def empty(self) -> Observation:
        """Returns uninitialized arrays for the observations of all worlds."""
        if isinstance(self.observation_space, spaces.Box):
            return np.empty((self.n, *self.observation_space.shape), np.float32)
        return {name: np.empty((self.n, *shape), np.float32) for name, shape in self.shapes.items()}

    def reset(
        self, mask: NDArray[np.bool_], seeds: Sequence[int | None], options: Mapping[str, Any], out: Observation
    ) -> None:
        """Starts episodes in the worlds selected by `mask` and writes their observations to `out`."""
        seeds = [None if seed is None else seed % 2**64 for seed in seeds]
        blueprint, start = options.get("blueprint"), options.get("start")
        self.worlds.reset(mask, seeds, blueprint, start, arrays(out))

    def step(
        self, action: Action, resets: NDArray[np.bool_], out: Observation, name: str = "actions"
    ) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.float32]]:
        """Steps each world, or starts an episode where `resets` is set. See `Worlds.step` of the native module.

        `action` is a batch, or with the name `action` that of a single world.
        """
        self.check_open()
        choices, moves = self.to_native(action, name, resets)
        return self.worlds.step(choices, moves, resets, arrays(out))

    def to_native(
        self, action: Action, name: str = "actions", resets: NDArray[np.bool_] | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Converts a batch of actions, or one named `action`, to choices [n, grippers] and moves [n, 16, 6].

        Worlds of `resets` [n] do not act, so their generators draw no noise.
        """
        lead = () if name == "action" else (self.n,)
        if self.picks:
            picks = checks.picks(name, action, (*lead, self.n_grippers), N_PICKS)
            resets = np.zeros(self.n, np.bool_) if resets is None else resets
            return self.worlds.picked(picks.reshape(self.n, -1), resets, self.noise, self.masked)
        if isinstance(action, Mapping):
            if self.flat_action:
                raise refusal(name, action, "flat numbers")
            choices, moves = parts_of(name, action, ("choices", "moves"))
            choices = checks.blocks(f"{name}: choices", choices, (*lead, self.n_grippers))
            moves = checks.numbers(f"{name}: moves", moves, (*lead, N_BLOCKS, N_MOVES))
            return choices.reshape(self.n, -1), moves.reshape(self.n, N_BLOCKS, N_MOVES)
        if not self.flat_action:
            raise refusal(name, action, "a dictionary of choices and moves")
        shape = (*lead, self.n_grippers * N_FLAT)
        flat = checks.array(name, action, f"numbers of shape {shape}")
        if flat.size != self.n * self.n_grippers * N_FLAT:
            raise ValueError(f"{name} has shape {flat.shape}: expected {shape}")
        flat = flat.astype(np.float32).reshape(self.n, self.n_grippers, N_FLAT)
        return unflatten(flat, self.allowed())

    def allowed(self) -> NDArray[np.bool_] | None:
        """Returns which block scores of flat actions count [n, 16], or None if all do."""
        return self.worlds.allowed() if self.masked else None

    def action_masks(self) -> NDArray[np.bool_]:
        """Returns which picks are offered [n, grippers · 528], the same ones to each gripper."""
        if not self.picks:
            raise ValueError("action_masks() is for the action 'proposals'")
        return np.tile(self.worlds.offered(self.masked), self.n_grippers)

    def within_mask(self, moves: NDArray[np.float32]) -> NDArray[np.float32]:
        """Returns the moves [n, 16, 6] with zeros for blocks that no flat action can choose.

        A flat action with such a choice takes another block instead, which must not make the move.
        """
        allowed = self.allowed()
        return moves if allowed is None else np.where(allowed[:, :, None], moves, np.float32(0.0))

    def from_native(self, choices: NDArray[np.int64], moves: NDArray[np.float32]) -> Action:
        """Converts choices and moves to a batch of actions in the action space. ValueError if those are proposals."""
        if self.picks:
            raise ValueError("env: only picks among proposals act here: expected the action native or flat")
        moves = self.within_mask(moves.clip(-1.0, 1.0))
        return flatten(choices, moves).reshape(self.n, -1) if self.flat_action else {"choices": choices, "moves": moves}

    def set_scene(self, row: int, scene: Mapping[str, Any], out: Observation) -> None:
        """Begins a world's episode anew in a scene and writes the observations of all worlds to `out`."""
        self.check_open()
        names = ("positions", "orientations", "connections")
        positions, orientations, connections = parts_of("scene", checks.mapping("scene", scene), names)
        positions = checks.numbers("scene: positions", positions, (N_BLOCKS, 3))
        orientations = checks.numbers("scene: orientations", orientations, (N_BLOCKS, 4))
        pairs = np.atleast_1d(checks.array("scene: connections", connections, "pairs of blocks"))
        # An empty list has no type.
        pairs = checks.blocks("scene: connections", pairs, (len(pairs), 2)) if pairs.size else np.empty((0, 2), np.int64)
        self.worlds.set_scene(row, positions, orientations, [(int(a), int(b)) for a, b in pairs])
        self.worlds.observe(self.worlds.features, arrays(out))

    def about(self, row: int) -> dict[str, Any]:
        """Returns the episode's info dictionary for `reset`."""
        blueprint, start, _ = self.worlds.episode(row)
        return {"blueprint": blueprint, "start": start}


def arrays(observation: Observation) -> list[NDArray[np.float32]]:
    """Returns the arrays of a batch of observations in the order that the native module expects."""
    if isinstance(observation, dict):
        return [observation["nodes"], observation["edges"], observation["globals"]]
    return [observation]


def parts_of(name: str, whole: Mapping[str, Any], names: Sequence[str]) -> list[Any]:
    """Returns the named parts of an action or observation; raises ValueError if one is missing."""
    for part in names:
        if part not in whole:
            raise ValueError(f"{name} has no {part}: expected a dictionary of {' and '.join(names)}")
    return [whole[part] for part in names]


def row_of(batch: Any, row: int) -> Any:
    """Returns one row of a batch of observations or actions."""
    return {name: values[row] for name, values in batch.items()} if isinstance(batch, dict) else batch[row]


def unflatten(
    flat: NDArray[np.float32], allowed: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Converts flat actions [n, grippers, 22] to choices [n, grippers] and moves [n, 16, 6].

    Ignores the scores of blocks that are not `allowed` [n, 16].
    """
    n, n_grippers, _ = flat.shape
    rows = np.arange(n)
    scores = flat[..., :N_BLOCKS]
    if allowed is not None:
        scores = np.where(allowed[:, None], scores, -np.inf)
    choices = scores.argmax(axis=-1)
    moves = np.zeros((n, N_BLOCKS, N_MOVES), np.float32)
    for gripper in range(n_grippers):
        moves[rows, choices[:, gripper]] += flat[:, gripper, N_BLOCKS:]
    if n_grippers == 2:
        same = np.flatnonzero(choices[:, 0] == choices[:, 1])
        moves[same, choices[same, 0]] /= 2
    return choices, moves


def flatten(choices: NDArray[np.int64], moves: NDArray[np.float32]) -> NDArray[np.float32]:
    """Converts choices [n, grippers] and moves [n, 16, 6] to flat actions [n, grippers, 22]."""
    n, n_grippers = choices.shape
    flat = np.full((n, n_grippers, N_FLAT), -1.0, np.float32)
    rows = np.arange(n)
    for gripper in range(n_grippers):
        flat[rows, gripper, choices[:, gripper]] = 1.0
        flat[:, gripper, N_BLOCKS:] = moves[rows, choices[:, gripper]]
    return flat


def _json(name: str, section: Any) -> str:
    return json.dumps(checks.plain(name, checks.mapping(name, section)))


def _box(limit: float, shape: tuple[int, ...]) -> spaces.Box:
    return spaces.Box(-limit, limit, shape, np.float32)

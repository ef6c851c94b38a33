"""Tests that whatever is wrong with an argument is refused with its name, its value, and what is allowed.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import inspect
import subprocess
import sys
import unittest
from collections.abc import Callable, Iterator
from typing import Any

import golden
import lodestone
import numpy as np
from lodestone.batch import MAX_WORLDS, Batch
from lodestone.parallel import AssemblyParallelEnv, parallel_env
from lodestone.sb3 import AssemblyVecEnv

FOREIGN = object()
NAN = float("nan")
# A text that has no form in UTF-8.
LONE = "\ud800"
CALLABLES = (
    lodestone.AssemblyEnv,
    lodestone.AssemblyVectorEnv,
    AssemblyParallelEnv,
    AssemblyVecEnv,
    lodestone.Policy,
    lodestone.Expert,
    lodestone.blueprints,
    lodestone.proposals,
    parallel_env,
)
# What takes anything: ignored, passed on to another method, or Python's own affair.
ANYTHING = {
    "AssemblyVectorEnv.close_extras(kwargs)",
    "AssemblyVecEnv.set_attr(value)",
    "AssemblyVecEnv.env_method(method_args)",
    "AssemblyVecEnv.env_method(method_kwargs)",
    "AssemblyVecEnv.env_is_wrapped(wrapper_class)",
    "Policy.predict(state)",
    "Policy.predict(episode_start)",
}

# The wrong values of an argument: alone, or with what the message shows in place of the value.
NAMES = (
    3,
    b"2_000",
    {"2_000": 1},
    [],
    LONE,
    2.5,
    FOREIGN,
    ("nowhere", '"nowhere"'),
    ("/nowhere.toml", "/nowhere.toml"),
)
NAMES += ((["2_000", 3], "[1] is 3"), ([b"2_000"], "[0] is b'2_000'"), (None, "None"))
WORLD: dict[str, tuple[Any, ...]] = {
    "blueprint": NAMES,
    "starts": (
        *(None, 3, b"scattered", ["scattered"], LONE, ("upside-down", '"upside-down"'), ({}, "no positive weight")),
        *(({"scattered": "x"}, "['scattered'] is 'x'"), ({"scattered": None}, "['scattered'] is None")),
        *(({"scattered": True}, "['scattered'] is True"), ({3: 1.0}, "3"), ({"scattered": -1}, "-1")),
        *(({"scattered": NAN}, "NaN"), ("near-goal:16", '"near-goal:16"'), ("prebuilt:train", '"train"')),
    ),
    "shuffle_blocks": (None, 3, "x", [True]),
    "settings": (
        *(3, b"x", ["x"], 2.5, LONE, ("/nowhere.toml", "/nowhere.toml"), ({3: 4}, "3")),
        *(
            ({"episode_steps": bad}, f"settings.episode_steps = {shown}: expected 1..=1000")
            for bad, shown in [
                ("x", '"x"'),
                (70_000, "70000"),
                (-1, "-1"),
                (0, "0"),
                (1001, "1001"),
                (1.5, "1.5"),
                (None, "null"),
                ([1], "[1]"),
                ({"a": 1}, '{"a":1}'),
                (True, "true"),
            ]
        ),
        ({"episode_steps": NAN}, "settings.episode_steps is nan"),
        ({"episode_steps": {5}}, "settings.episode_steps is {5}"),
        ({"episode_steps": 10**30}, f"settings.episode_steps is {10**30}"),
        ({"physics": {"friction": "x"}}, 'settings.physics.friction = "x": expected 0..=2'),
        ({"physics": {"friction": 9}}, "settings.physics.friction = 9: expected 0..=2"),
        ({"physics": 3}, "settings.physics = 3: expected"),
        ({"physics": {"n_grippers": 1}}, "settings.physics: unknown field `n_grippers`, expected one of `gravity_mps2`"),
        ({"fysics": {"friction": 1}}, "settings: unknown field `fysics`, expected one of `n_grippers`"),
        ({"randomization": {"friction": [1]}}, "settings.randomization.friction = [1]: expected 0.1..=10"),
        ({"randomization": {"friction": [2, 1]}}, "settings.randomization.friction = [2.0, 1.0]: expected the lower end"),
        ({"reward": {"dense_weight": "x"}}, 'settings.reward.dense_weight = "x": expected 0..=10'),
    ),
    "features": (
        *(None, 3, ["x"], "none", b"all", ({"up": True}, "features: unknown field `up`, expected one of `up_axis`")),
        *(({"up_axis": 3}, "features.up_axis = 3: expected a boolean"), ({3: True}, "3")),
    ),
    "observation": (None, 3, "pixels", ["flat"], b"flat", np.zeros(2)),
    "action": (None, 3, "joints", ["flat"], b"flat"),
    "mask": (3, "all", ["none"]),
    "noise": (None, 3, "x", [True]),
    "num_threads": (0, -1, 1.5, "x", True, 1025, 10**9),
}
MODES = (3, "ansi", ["human"], b"human")
SIZES = (None, 3, "x", (1,), (640, 480, 3), (640.5, 480), (31, 480), (640, 4097), ["a", "b"])
COUNTS = (0, -1, 1.5, "x", None, True, MAX_WORLDS + 1, 10**9, [3])
SEEDS = (-1, 1.5, "x", b"x", True, FOREIGN)
OPTIONS = (3, "x", [3], ({"blueprnt": "2_000"}, "'blueprnt'"), ({3: "x"}, "3"), ({"start": 3}, "'start' is 3"))
OPTIONS += (({"blueprint": b"2_000"}, "'blueprint' is b'2_000'"), ({"blueprint": "train"}, '"train"'))
CHOICES, MOVES = np.zeros(2, np.int64), np.zeros((16, 6), np.float32)
PARTS = (
    *(None, 3, "x", FOREIGN, np.zeros(44)),
    *(({"choices": CHOICES}, "no moves"), ({"moves": MOVES}, "no choices"), ({**{}}, "no choices")),
    *(
        ({"choices": bad, "moves": MOVES}, f"choices {shown}")
        for bad, shown in [
            (None, "is None"),
            ("x", "is 'x'"),
            (CHOICES + 0.5, "has the type float64"),
            (CHOICES[:1], "has shape (1,)"),
            ([[1], [1, 2]], "is [[1], [1, 2]]"),
        ]
    ),
    *(
        ({"choices": CHOICES, "moves": bad}, f"moves {shown}")
        for bad, shown in [
            (None, "is None"),
            ("x", "is 'x'"),
            (MOVES[:, :5], "has shape (16, 5)"),
            (MOVES + 1j, "is an array of complex"),
        ]
    ),
)


def constructors() -> Iterator[tuple[str, Callable[..., Any], tuple[Any, ...]]]:
    """Yields an argument's place, what to call with it, and wrong values."""
    kinds: tuple[tuple[str, Callable[..., Any], dict[str, tuple[Any, ...]]], ...] = (
        ("AssemblyEnv", lodestone.AssemblyEnv, {"render_mode": MODES, "render_size": SIZES}),
        ("AssemblyParallelEnv", AssemblyParallelEnv, {"render_mode": MODES, "render_size": SIZES}),
        ("parallel_env", parallel_env, {}),
        (
            "AssemblyVectorEnv",
            lodestone.AssemblyVectorEnv,
            {
                "num_envs": COUNTS,
                "autoreset_mode": (None, 3, "x", ["NextStep"]),
                "copy": (None, 3, "x"),
                "render_mode": (*MODES, "human"),
                "render_size": SIZES,
            },
        ),
        ("AssemblyVecEnv", AssemblyVecEnv, {"num_envs": COUNTS, "render_mode": (*MODES, "human")}),
        ("Batch", Batch, {"n": COUNTS}),
    )
    for place, make, own in kinds:
        first = {"AssemblyVecEnv": {"num_envs": 1}, "Batch": {"n": 1}}.get(place, {})
        for name, values in {**own, **WORLD}.items():
            yield f"{place}({name})", lambda value, m=make, f=first, n=name: m(**{**f, n: value}), values


def methods() -> Iterator[tuple[str, Callable[..., Any], tuple[Any, ...]]]:
    """Yields the same for methods and functions."""
    env, flat = lodestone.AssemblyEnv(blueprint="2_000"), lodestone.AssemblyEnv(blueprint="2_000", action="flat")
    envs = lodestone.AssemblyVectorEnv(2, blueprint="2_000")
    pair, pair_flat = parallel_env(blueprint="2_000"), parallel_env(blueprint="2_000", action="flat")
    sb3 = AssemblyVecEnv(2, blueprint="2_000")
    policy = golden.native(golden.gaussian())
    (seen, _), *_ = (one.reset(seed=1) for one in (env, flat, envs, pair, pair_flat))
    sb3.reset()
    several = (
        *SEEDS[:-1],
        FOREIGN,
        ([1], "1 entries"),
        ([1, "x"], "[1] is 'x'"),
        ([1, -1], "[1] is -1"),
        (np.ones(2), "1.0"),
    )
    masks = tuple(
        ({"reset_mask": bad}, "reset_mask") for bad in (3, "x", [True], [1, 0], [False, False], [[True], [True, False]])
    )
    yield "AssemblyEnv.reset(seed)", lambda value: env.reset(seed=value), SEEDS
    yield "AssemblyEnv.reset(options)", lambda value: env.reset(options=value), OPTIONS
    yield "AssemblyEnv.step(action)", env.step, PARTS
    for name, one in (("AssemblyEnv.step(action)", flat.step), ("AssemblyVecEnv.step_async(actions)", sb3.step)):
        yield (
            name,
            one,
            (
                None,
                "x",
                FOREIGN,
                (3, "()"),
                (np.zeros(43), "(43,)"),
                {"choices": CHOICES, "moves": MOVES},
                [[1], [1, 2]],
            ),
        )
    yield "AssemblyVectorEnv.reset(seed)", lambda value: envs.reset(seed=value), several
    yield "AssemblyVectorEnv.reset(options)", lambda value: envs.reset(options=value), (*OPTIONS, *masks)
    batched = tuple(bad for bad in PARTS if not isinstance(bad, tuple))
    yield "AssemblyVectorEnv.step(actions)", envs.step, (*batched, ({"choices": CHOICES, "moves": MOVES}, "shape (2,)"))
    yield "AssemblyVectorEnv.scene(row)", envs.scene, (-1, 2, 0.5, "x", None)
    scene = env.scene()
    scenes = (
        *(3, "x", (None, "no positions"), ({**scene, "positions": scene["positions"][:3]}, "(3, 3)")),
        *(({**scene, "orientations": None}, "is None"), ({**scene, "connections": [(0, 16)]}, "16")),
    )
    yield "AssemblyEnv.set_scene(scene)", env.set_scene, scenes
    yield "AssemblyVectorEnv.set_scene(scene)", lambda value: envs.set_scene(0, value), scenes
    yield "AssemblyVectorEnv.set_scene(row)", lambda value: envs.set_scene(value, scene), (-1, 2, 0.5, "x", None)
    yield "AssemblyParallelEnv.reset(seed)", lambda value: pair.reset(seed=value), SEEDS
    yield "AssemblyParallelEnv.reset(options)", lambda value: pair.reset(options=value), OPTIONS
    for name in ("observation_space", "action_space"):
        yield f"AssemblyParallelEnv.{name}(agent)", getattr(pair, name), (None, 3, "gripper_2", ["gripper_0"])
    fine = {"choice": 0, "move": np.zeros(6)}
    one_of_two = [({"gripper_0": fine}, "gripper_1"), ({"gripper_0": fine, "gripper_1": 3}, "gripper_1 is 3")]
    for part, values in (("choice", (16, -1, 1.5, "x", None)), ("move", (None, "x", 0.3, np.zeros(5), [[1], [1, 2]]))):
        for bad in values:
            shown = f"{part} of gripper_0"
            one_of_two.append(({"gripper_0": {**fine, part: bad}, "gripper_1": fine}, shown))
    yield "AssemblyParallelEnv.step(actions)", pair.step, (None, 3, "x", *one_of_two)
    flats = (({"gripper_0": bad, "gripper_1": np.zeros(22)}, "gripper_0") for bad in (None, 3, "x", fine, np.zeros(21)))
    yield "AssemblyParallelEnv.step(actions)", pair_flat.step, tuple(flats)
    two, moves = CHOICES[None], MOVES[None]
    yield (
        "AssemblyParallelEnv.from_native(choices)",
        lambda value: pair.from_native(value, moves),
        (*(None, "x", (3.5, "float64"), FOREIGN, (CHOICES, "(2,)"), (two + 16, "is 16")),),
    )
    yield (
        "AssemblyParallelEnv.from_native(moves)",
        lambda value: pair.from_native(two, value),
        (None, "x", FOREIGN, (MOVES, "(16, 6)")),
    )
    yield "AssemblyVecEnv.seed(seed)", sb3.seed, SEEDS
    yield (
        "AssemblyVecEnv.set_options(options)",
        sb3.set_options,
        (*OPTIONS[:2], *OPTIONS[3:-1], ([{}], "1 entries"), ([{}, 3], "options[1] is 3")),
    )
    for method in ("get_attr", "set_attr", "env_method", "env_is_wrapped"):
        call = getattr(sb3, method)
        given = {"set_attr": ("render_size", (64, 64)), "env_method": ("render",), "get_attr": ("num_envs",)}.get(
            method, (object,)
        )
        yield (
            f"AssemblyVecEnv.{method}(indices)",
            lambda value, c=call, g=given: c(*g, indices=value),
            (2, -1, "x", 0.5, FOREIGN, ([0, 2], "2")),
        )
    yield "AssemblyVecEnv.get_attr(attr_name)", sb3.get_attr, (None, 3)
    yield "AssemblyVecEnv.set_attr(attr_name)", lambda value: sb3.set_attr(value, 1), (None, 3)
    yield "AssemblyVecEnv.env_method(method_name)", sb3.env_method, (None, 3)
    yield "Policy(native)", lodestone.Policy, (None, 3, policy)
    for name, make in (
        ("Policy", lambda value: lodestone.Policy(policy.native, value)),
        ("Policy.pretrained", lodestone.Policy.pretrained),
        ("Policy.load", lambda value: lodestone.Policy.load(__file__, value)),
    ):
        yield f"{name}(action)", make, WORLD["action"]
    yield "Policy.load(path)", lodestone.Policy.load, (None, 3, b"policy.safetensors", ["x"], (__file__, __file__))
    yield "Policy.seed(seed)", policy.seed, (*SEEDS, None, 2**64)
    for agent in (policy, lodestone.Expert()):
        yield f"{type(agent).__name__}.act(env)", agent.act, (None, 3, FOREIGN, lodestone.AssemblyEnv)
    yield "Policy.act(deterministic)", lambda value: policy.act(env, value), (None, 3, "x")
    yield "Policy.predict(deterministic)", lambda value: policy.predict(seen, deterministic=value), (None, 3, "x")
    for method in ("predict", "evaluate"):
        yield (
            f"Policy.{method}(observation)",
            getattr(policy, method),
            (
                *(
                    None,
                    "x",
                    FOREIGN,
                    (3, "()"),
                    (np.zeros(9), "(9,)"),
                    ({}, "no nodes"),
                    ({**seen, "edges": "x"}, "edges is 'x'"),
                ),
                *(
                    ({**seen, "nodes": seen["nodes"][:3]}, "(3, 10)"),
                    ({**seen, "globals": seen["globals"] * NAN}, "not finite"),
                ),
            ),
        )
    yield "blueprints(blueprint)", lodestone.blueprints, NAMES
    yield "proposals(env)", lodestone.proposals, (None, 3, FOREIGN, lodestone.AssemblyEnv)
    picks = lodestone.AssemblyEnv(blueprint="2_000", action="proposals")
    picks.reset(seed=1)
    wrong = ([0, 528], "528"), ([-1, 0], "-1"), ([0.5, 0], "float64"), ([0], "(1,)"), ([[1], [1, 2]], "[[1], [1, 2]]")
    yield "AssemblyEnv.step(action)", picks.step, (None, "x", FOREIGN, {"choices": CHOICES}, *wrong)


class Arguments(unittest.TestCase):
    def test_each_wrong_value_is_refused_by_name(self) -> None:
        for place, call, values in (*constructors(), *methods()):
            name = place.rsplit("(", 1)[1].rstrip(")")
            for bad, words in map(case, values):
                with self.subTest(place, value=bad):
                    with self.assertRaises(ValueError) as raised:
                        call(bad)
                    message = str(raised.exception)
                    # Some arguments hold several of something, and the message speaks of one.
                    told = {"starts": ("start",), "options": ("option", "blueprint", "start")}.get(name, (name,))
                    self.assertTrue(any(part in message for part in told), message)
                    self.assertIn(words if words is not None else shown(bad), message)
                    if words is None:
                        self.assertIn("expected ", message)

    def test_every_argument_is_tried(self) -> None:
        tried = {place for place, _, _ in (*constructors(), *methods())}
        for made in CALLABLES:
            name = made.__name__
            own = {
                n: f
                for n, f in vars(made).items()
                if inspect.isroutine(f) or isinstance(f, (classmethod, staticmethod))
            }
            parts = (
                {f"{name}.{n}": getattr(made, n) for n in own if not n.startswith("_")} if inspect.isclass(made) else {}
            )
            for place, part in {name: made, **parts}.items():
                for argument in inspect.signature(part).parameters.values():
                    if argument.name == "self":
                        continue
                    if argument.kind is argument.VAR_KEYWORD and place in (name, "parallel_env"):
                        expected = {f"{place}({key})" for key in WORLD}
                    else:
                        expected = {f"{place}({argument.name})"} - ANYTHING
                    self.assertLessEqual(expected, tried)
        self.assertEqual({*WORLD}, {*inspect.signature(Batch).parameters} - {"n"})

    def test_no_refusal_changes_the_world(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000")
        env.reset(seed=1)
        before = env.scene()["positions"]
        for bad in PARTS:
            with self.assertRaises(ValueError):
                env.step(bad[0] if isinstance(bad, tuple) else bad)
        np.testing.assert_array_equal(env.scene()["positions"], before)


def case(value: Any) -> tuple[Any, str | None]:
    """Returns a wrong value, and what the message shows if that is not the value."""
    has_words = isinstance(value, tuple) and len(value) == 2 and isinstance(value[1], str)
    return value if has_words else (value, None)


def shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} with shape {value.shape}"
    # Cut as in messages.
    return repr(value)[:20]


class Memory(unittest.TestCase):
    """What does not fit is a MemoryError, and the interpreter goes on."""

    PROGRAM = """
import resource, sys
import lodestone
from lodestone.batch import Batch

n = int(sys.argv[1])
Batch(1, blueprint="2_000")
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 512 * 2**20
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
try:
    Batch(n, blueprint="2_000")
except MemoryError as error:
    print(error)
print(len(Batch(8, blueprint="2_000").worlds.allowed()))
"""

    @unittest.skipUnless(sys.platform == "linux", "limits of memory are tested on Linux")
    def test_worlds_beyond_the_memory_are_refused(self) -> None:
        command = [sys.executable, "-c", self.PROGRAM, str(MAX_WORLDS)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        self.assertRegex(done.stdout, rf"^no memory for {MAX_WORLDS} worlds, which take up to \d+ MB\n8\n$")


if __name__ == "__main__":
    unittest.main()

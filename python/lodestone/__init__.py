"""Python environments in which two grippers assemble magnet blocks into blueprints.

`import lodestone` registers `Lodestone/Assembly-v0` with Gymnasium:

    env = gymnasium.make("Lodestone/Assembly-v0", blueprint="4_000")
    envs = gymnasium.make_vec("Lodestone/Assembly-v0", num_envs=32, blueprint="4_000")

`lodestone.parallel` provides the same world for PettingZoo, with one agent per gripper. `lodestone.sb3` provides a
batch of worlds for Stable-Baselines3. `lodestone.record` records episodes as Minari datasets.
"""

import gymnasium

from lodestone.agents import Expert, Policy
from lodestone.batch import REWARD_TERMS, blueprints
from lodestone.env import AssemblyEnv
from lodestone.proposed import proposals
from lodestone.vector import AssemblyVectorEnv

__all__ = ["REWARD_TERMS", "AssemblyEnv", "AssemblyVectorEnv", "Expert", "Policy", "blueprints", "proposals"]

ENV_ID = "Lodestone/Assembly-v0"

if ENV_ID not in gymnasium.registry:
    gymnasium.register(
        ENV_ID,
        entry_point="lodestone.env:AssemblyEnv",
        vector_entry_point="lodestone.vector:AssemblyVectorEnv",
    )

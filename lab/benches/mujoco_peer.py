"""Simulates the same 16 blocks in MuJoCo and prints a JSON object: version, and control steps per CPU-second by case.

A control step is 10 substeps of 10 ms, as in this crate's bench `world`. Run by lab/benches/peers.py.

settled: the blocks are left alone. random: two random blocks get a random velocity at each control step.
held: the 16 blocks are welded into one row (one weld per joint), gravity compensated, and held still.
moved: like held, but the row swings. MuJoCo computes no magnets, features, or rewards, so the comparison favors it.
"""

import json
import resource

import mujoco
import numpy as np

CELLS = [(1, 1, 1)] * 4 + [(2, 1, 1)] * 4 + [(3, 1, 1)] * 2 + [(4, 1, 1)] * 2 + [(2, 2, 1)] * 2 + [(3, 2, 1)] * 2
UNIT, DENSITY, FRICTION = 0.1, 200, 0.6
SUBSTEPS, DT = 10, 0.01


def model(row):
    """Builds a model of blocks scattered on the ground or, with `row`, welded end to end a meter above it."""
    bodies, welds, x = "", "", 0.0
    for i, c in enumerate(CELLS):
        if row:
            x += c[0] * UNIT / 2
            position = (x, 0, 1)
            x += c[0] * UNIT / 2
        else:
            position = ((i % 4) * 0.5, (i // 4) * 0.5, c[2] * UNIT / 2)
        size = " ".join(str(k * UNIT / 2) for k in c)
        bodies += f'<body name="b{i}" pos="{position[0]} {position[1]} {position[2]}" gravcomp="{int(row)}"><freejoint/>'
        bodies += f'<geom type="box" size="{size}" density="{DENSITY}" friction="{FRICTION} 0.005 0.0001"/></body>'
        if row and i:
            welds += f'<weld body1="b{i - 1}" body2="b{i}"/>'
    exclude = "".join(f'<exclude body1="b{i - 1}" body2="b{i}"/>' for i in range(1, len(CELLS))) if row else ""
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{DT}"/><worldbody><geom type="plane" size="20 20 1"/>{bodies}</worldbody>'
        f"<equality>{welds}</equality><contact>{exclude}</contact></mujoco>"
    )


def cpu_seconds():
    use = resource.getrusage(resource.RUSAGE_SELF)
    return use.ru_utime + use.ru_stime


def rate(case, n_steps=400):
    """Returns control steps per CPU-second."""
    row = case in ("held", "moved")
    m = model(row)
    d = mujoco.MjData(m)
    rng = np.random.default_rng(0)
    for _ in range(50 * SUBSTEPS):
        mujoco.mj_step(m, d)
    start = cpu_seconds()
    for t in range(n_steps):
        held = rng.choice(16, 2, replace=False)
        velocity = rng.uniform(-1, 1, (2, 6)) * [3, 3, 3, 6.28, 6.28, 6.28]
        if case == "random" and t % 100 == 0:
            mujoco.mj_resetData(m, d)
        for _ in range(SUBSTEPS):
            if case == "random":
                for b, v in zip(held, velocity):
                    d.qvel[6 * b : 6 * b + 6] = v
            elif row:
                d.qvel[:] = 0
                if case == "moved":
                    # Rigid rotation about the row's first block: v = omega x r.
                    d.qvel[1::6] = 0.5 * (d.qpos[0::7] - d.qpos[0])
                    d.qvel[5::6] = 0.5
            mujoco.mj_step(m, d)
    return n_steps / (cpu_seconds() - start)


def main():
    rates = {case: rate(case) for case in ("settled", "random", "held", "moved")}
    print(json.dumps({"version": mujoco.__version__} | rates))


if __name__ == "__main__":
    main()

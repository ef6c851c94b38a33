#!/usr/bin/env python3
"""Plays an episode and writes it for the Rerun viewer: blocks, connections, grippers, rewards, and pictures over time.

    pip install ./python rerun-sdk
    python python/examples/rerun_episode.py --blueprint 4_000 --out episode.rrd
    rerun episode.rrd
"""

from __future__ import annotations

import argparse

import lodestone
import rerun as rr

LOOSE, MEMBER, HELD = [150, 150, 150], [90, 150, 230], [240, 160, 40]


def log_scene(recording: rr.RecordingStream, scene: dict) -> None:
    """Logs a scene at the present time."""
    colors = [MEMBER if member else LOOSE for member in scene["in_blueprint"]]
    for block in scene["held"][scene["held"] >= 0]:
        colors[block] = HELD
    positions = scene["positions"]
    boxes = rr.Boxes3D(
        centers=positions,
        half_sizes=scene["half_extents"],
        quaternions=scene["orientations"],
        colors=colors,
        labels=[str(block) for block in range(len(positions))],
        show_labels=False,
    )
    recording.log("world/blocks", boxes)
    recording.log("world/connections", rr.LineStrips3D(positions[scene["connections"]], colors=[230, 70, 70]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agent", default="pretrained", help="pretrained, expert, or a file of lodestone export")
    parser.add_argument("--blueprint", default="4_000", help="id, split, or path of a TOML file")
    parser.add_argument("--start", default="scattered", help="scattered, prebuilt, near-goal:N, ...")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", required=True, metavar="FILE", help="recording, such as episode.rrd")
    args = parser.parse_args()
    if args.agent == "expert":
        agent = lodestone.Expert()
    else:
        policy = lodestone.Policy
        agent = policy.pretrained() if args.agent == "pretrained" else policy.load(args.agent)
    env = lodestone.AssemblyEnv(blueprint=args.blueprint, starts=args.start, render_mode="rgb_array")
    _, about = env.reset(seed=args.seed)

    recording = rr.RecordingStream("lodestone", recording_id=f"{about['blueprint']}-{args.seed}")
    recording.save(args.out)
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    step, is_over, total, info = 0, False, 0.0, {"is_success": False}
    while True:
        recording.set_time("time", duration=0.1 * step)
        log_scene(recording, env.scene())
        recording.log("picture", rr.Image(env.render()).compress(jpeg_quality=85))
        recording.log("return", rr.Scalars(total))
        if is_over:
            break
        _, reward, terminated, truncated, info = env.step(agent.act(env))
        for name, term in zip(lodestone.REWARD_TERMS, info["reward_terms"]):
            recording.log(f"reward/{name}", rr.Scalars(float(term)))
        step, is_over, total = step + 1, terminated or truncated, total + reward
    recording.flush()
    print(f"{args.out}: {about['blueprint']}, {step} steps, {'built' if info['is_success'] else 'not built'}")


if __name__ == "__main__":
    main()

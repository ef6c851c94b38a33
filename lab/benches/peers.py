#!/usr/bin/env python3
"""Compares Lodestone with its peers, in turn on one machine, and prints Markdown tables with ratios.

    python3 lab/benches/peers.py --install             # everything, about ten minutes after the builds
    python3 lab/benches/peers.py network --rounds 1    # one table; or: update, world

--install installs the peers listed in lab/benches/requirements.txt into target/python. Without it, they are looked up
in the current Python, and missing peers are left out of their tables. Our side is built in the release profile.

Everything runs on one thread. Each figure is the best of all rounds, per CPU-second, except for the update, which uses
wall time. Other load distorts all figures, so keep the machine idle. A ratio above 1 means that Lodestone is faster.
The limit is what this core could reach if the network's matrix products, as torch computes them, ran as fast as one
large product. Ours need fewer operations in the first layer.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
REQUIREMENTS = Path(__file__).with_name("requirements.txt")
VENV = ROOT / "target/python"
# Table -> package and benchmark that measure our side.
BENCHES = ["network", "update", "world"]
# Peer -> program that measures it and the modules it needs.
PEERS = {
    "jax": ("lab/benches/jax_peer.py", ["jax"]),
    "torch": ("lab/benches/torch_peer.py", ["torch", "safetensors"]),
    "MuJoCo": ("lab/benches/mujoco_peer.py", ["mujoco", "numpy"]),
}
NETWORK_ROWS = {
    ("forward", 1): "forward, batch 1",
    ("forward", 16): "forward, batch 16",
    ("forward", 64): "forward, batch 64",
    ("update", 64): "forward and backward, batch 64",
    ("update", 256): "forward and backward, batch 256",
}
WORLD_ROWS = {
    "settled": "settled",
    "random": "random actions",
    "held": "16 blocks in a row, held",
    "moved": "the same, swung",
}
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")}


def say(text: str) -> None:
    """Prints progress to standard error. The tables go to standard output."""
    print(text, file=sys.stderr, flush=True)


def run(*command: str | Path) -> str:
    """Runs a program on one thread and returns its output. Exits if it fails."""
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=ROOT, env=os.environ | ONE_THREAD, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(words)} failed with exit code {done.returncode}")
    return done.stdout


def install() -> Path:
    """Installs the peers and returns the path of their Python."""
    run(sys.executable, ROOT / "python/environment.py", VENV, REQUIREMENTS)
    return VENV / "bin/python"


def build(tables: list[str]) -> dict[str, Path]:
    """Builds the benchmarks of these tables and returns their paths."""
    benches = [word for table in tables for word in ("--bench", table)]
    command = ["cargo", "bench", "--locked", "--no-run", "--message-format=json", "-p", "lab", *benches]
    lines = run(*command).splitlines()
    messages = [json.loads(line) for line in lines if line.startswith("{")]
    built = {m["target"]["name"]: m["executable"] for m in messages if m.get("executable")}
    return {table: Path(built[table]) for table in tables}


def newest(folder: Path, tables: list[str]) -> dict[str, Path]:
    """Returns the newest benchmark per table in the folder of an earlier build. Tables without one are left out."""
    found = {}
    for table in tables:
        programs = [p for p in folder.glob(f"{table}-*") if not p.suffix and os.access(p, os.X_OK)]
        if programs:
            found[table] = max(programs, key=lambda p: p.stat().st_mtime)
        else:
            print(f"not run: {table}, as {folder} has no bench {table}-*\n")
    return found


def present(names: list[str]) -> dict[str, Path]:
    """Returns those of the named peers that can run, and prints a line for each of the others."""
    found = {}
    for name in names:
        program, modules = PEERS[name]
        missing = [module for module in modules if not find_spec(module)]
        if missing:
            print(f"not run: {name}, as this Python has no module {missing[0]} (--install brings it)\n")
        else:
            found[name] = ROOT / program
    return found


def commit() -> str:
    """Returns the commit that was built, and whether it has local changes."""
    changed = " with changes" if run("git", "status", "--porcelain", "-uno").strip() else ""
    return run("git", "rev-parse", "--short", "HEAD").strip() + changed


def machine(what: str | Path) -> str:
    """Describes what was measured, the date, the processor, and the machine's load."""
    info = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: (.*)", info.read_text()) if info.exists() else None
    processor = model[1].strip() if model else "a processor without a name"
    load = f"{os.getloadavg()[0]:.1f} at the start"
    return f"Measured: {what} ({datetime.date.today()}) on one core of {processor}; load {load}."


def number(x: float | None) -> str:
    return "–" if x is None else f"{x:,.0f}"


def ratio(ours: float | None, theirs: float | None) -> str:
    """Formats a ratio with about two significant digits."""
    if ours is None or theirs is None:
        return "–"
    x = ours / theirs
    return f"{x:.0f}" if x >= 10 else f"{x:.1f}" if x >= 2 else f"{x:.2f}"


def show(title: str, header: list[str], rows: list[list[str]]) -> None:
    print(f"## {title}\n")
    for line in (header, ["---"] * len(header), *rows):
        print("| " + " | ".join(line) + " |")
    print(flush=True)


class Figures:
    """The best figures that one side printed."""

    def __init__(self) -> None:
        self.version = ""
        self.rates: dict[tuple[str, int], float] = {}
        self.operations: dict[tuple[str, str], float] = {}
        self.flops = 0.0

    def take(self, output: str) -> None:
        for line in output.splitlines():
            match line.removeprefix("burn ").split():
                case ["forward" | "update" as kind, b, _, "ms/sample", rate, "samples/s"]:
                    case_ = (kind, int(b))
                    self.rates[case_] = max(self.rates.get(case_, 0.0), float(rate))
                case ["operations", kind, features, n]:
                    self.operations[kind, features] = float(n)
                case ["sgemm", _, rate, "GFLOP/s"]:
                    self.flops = max(self.flops, float(rate) * 1e9)
                case ["version", version]:
                    self.version = version


def network(program: Path, peers: dict[str, Path], rounds: int) -> Figures:
    """Prints the network table and returns torch's figures, which set the limits."""
    commands: dict[str, list[str | Path]] = {"ours": [program], "burn": [program, "burn"]}
    commands |= {name: [sys.executable, peer] for name, peer in peers.items()}
    sides = {name: Figures() for name in commands}
    for n in range(rounds):
        for name, command in commands.items():
            say(f"network, round {n + 1} of {rounds}: {name}")
            sides[name].take(run(*command))
    ours, torch = sides.pop("ours"), sides.get("torch", Figures())
    header = ["samples per CPU-second", "ours"]
    for name, side in sides.items():
        header += [f"{name} {side.version}".strip(), "ratio"]
    if torch.flops:
        header += [f"limit, {torch.flops / 1e9:.0f} GFLOP/s", "ratio"]
    rows = []
    for case, title in NETWORK_ROWS.items():
        own = ours.rates.get(case)
        row = [title, number(own)]
        for side in sides.values():
            row += [number(side.rates.get(case)), ratio(own, side.rates.get(case))]
        if torch.flops:
            limit = torch.flops / torch.operations[case[0], "paper"]
            row += [number(limit), ratio(own, limit)]
        rows.append(row)
    show("Network", header, rows)
    return torch


def update(program: Path, rounds: int, torch: Figures | None) -> None:
    """Prints the update table. It has a limit if torch was measured."""
    best = float("inf")
    for n in range(rounds):
        say(f"update, round {n + 1} of {rounds}")
        output = run(program)
        best = min([best, *(float(ms) for ms in re.findall(r"([\d.]+) ms a sample and epoch", output))])
    own = 1e3 / best
    header, row = ["samples per second", "ours"], ["a whole PPO update, per sample and epoch", number(own)]
    if torch is not None and torch.flops:
        # One forward-backward pass, plus the forward pass that recomputes the advantages.
        limit = torch.flops / sum(torch.operations[kind, "default"] for kind in ("forward", "update"))
        header += ["limit", "ratio"]
        row += [number(limit), ratio(own, limit)]
    show("Update", header, [row])


def world(program: Path, peers: dict[str, Path], rounds: int) -> None:
    """Prints the world table."""
    ours: dict[str, float] = {}
    theirs: dict[str, float] = {}
    version = ""
    for n in range(rounds):
        say(f"world, round {n + 1} of {rounds}")
        rates = json.loads(run(program, "--json"))
        ours = {case: max(rate, ours.get(case, 0.0)) for case, rate in rates.items()}
        for peer in peers.values():
            rates = json.loads(run(sys.executable, peer))
            version = rates.pop("version")
            theirs = {case: max(rate, theirs.get(case, 0.0)) for case, rate in rates.items()}
    header = ["control steps per CPU-second", "ours"] + [f"MuJoCo {version}", "ratio"] * bool(theirs)
    rows = []
    for case, title in WORLD_ROWS.items():
        row = [title, number(ours[case])]
        if theirs:
            row += [number(theirs[case]), ratio(ours[case], theirs[case])]
        rows.append(row)
    show("World", header, rows)


def main() -> None:
    """Prints the requested tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"one of {', '.join(BENCHES)}; all if none is named")
    parser.add_argument("--rounds", type=int, default=3, help="times that each side runs; 3 by default")
    parser.add_argument("--install", action="store_true", help="install the peers into target/python and use that")
    parser.add_argument("--binaries", type=Path, metavar="DIR", help="take benches built earlier from here")
    args = parser.parse_args()
    for table in args.tables:
        if table not in BENCHES:
            parser.error(f"there is no table {table}; there are: {', '.join(BENCHES)}")
    if args.rounds < 1:
        parser.error(f"--rounds {args.rounds}: expected at least 1")
    if args.install:
        python = install()
        os.execv(python, [str(python), *(a for a in sys.argv if a != "--install")])
    tables = args.tables or list(BENCHES)
    programs = newest(args.binaries.resolve(), tables) if args.binaries else build(tables)
    print(f"{machine(args.binaries or commit())} Best of {args.rounds}.\n")
    torch = None
    if "network" in programs:
        torch = network(programs["network"], present(["jax", "torch"]), args.rounds)
    if "update" in programs:
        update(programs["update"], args.rounds, torch)
    if "world" in programs:
        world(programs["world"], present(["MuJoCo"]), args.rounds)


if __name__ == "__main__":
    main()

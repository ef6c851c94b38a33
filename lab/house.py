#!/usr/bin/env python3
"""Counts what a reader of this repository has to read, each beside its limit. Exits with 1 if a limit is passed.

    python3 lab/house.py          # or: just house

Lines, settings, words, and dependencies are those of the files that git tracks. A limit that is not kept yet is a goal:
it is printed, and only what grew beyond today's count (`CEILINGS`) is an error.
"""

from __future__ import annotations

import collections
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# What is meant to be reached.
GOALS = {
    "lines of Rust outside lab/": 60_000,
    "of it without tests and comments": 32_000,
    "settings": 115,
    "commands": 18,
    "words on pages": 20_000,
    "largest room, % of all Rust": 15,
    "direct dependencies": 48,
    "passages of 12 equal lines": 0,
    "lines of README.md": 120,
}
# What is there today, for the goals that are not reached yet. Lower these when a count falls. A feature that adds lines
# raises them in a commit that says so.
CEILINGS = {
    "lines of Rust outside lab/": 66_164,
    "of it without tests and comments": 33_267,
}
N_EQUAL = 12


def tracked(*patterns: str) -> list[Path]:
    listed = subprocess.run(["git", "ls-files", *patterns], cwd=ROOT, check=True, capture_output=True, text=True)
    return [ROOT / name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]


def room(path: Path) -> str:
    return path.relative_to(ROOT).parts[0]


def is_test(path: Path) -> bool:
    parts = path.relative_to(ROOT).parts
    return parts[0] == "tests" or bool({"tests", "benches", "examples", "fuzz"} & set(parts)) or path.stem == "tests"


def code_of(text: str) -> list[str]:
    """Returns the lines without comments, blank lines, and the test module at the end of a file."""
    body = re.split(r"^#\[cfg\(test\)\]\n(?:#\[[^\n]*\]\n)*mod tests", text, maxsplit=1, flags=re.M)[0]
    lines = (line.strip() for line in body.splitlines())
    return [line for line in lines if line and not line.startswith("//")]


def n_settings(paths: list[Path]) -> int:
    """Counts the fields in all `settings!` blocks: `pub name: Type = default`, or a section without a default."""
    n_fields = 0
    for path in paths:
        for block in re.findall(r"^settings! \{\n(.*?)^\}", path.read_text(), flags=re.M | re.S):
            fields = re.findall(r"^ {8}pub \w+: ([^=;\n]+?)( = [^;]*)?;", block, flags=re.M)
            n_fields += sum(bool(default) for _, default in fields)
    return n_fields


def n_commands() -> int:
    enum = re.search(r"^pub enum Command \{\n(.*?)^\}", (ROOT / "deploy/src/cli.rs").read_text(), flags=re.M | re.S)
    return len(re.findall(r"^ {4}[A-Z]\w+(?:\(|,| \{)", enum[1] if enum else "", flags=re.M))


def n_words() -> int:
    """Counts the words of pages that people write; a page that begins with its generator's mark is not one."""
    pages = (path for path in tracked("*.md") if room(path) != "lab" and "docs/blueprints/" not in path.as_posix())
    texts = (path.read_text() for path in pages)
    return sum(len(text.split()) for text in texts if not text.startswith("<!-- Generated "))


def n_dependencies() -> int:
    """Counts the crates that members name themselves, without the members."""
    names: set[str] = set()
    manifests = tracked("*/Cargo.toml")
    for path in manifests:
        manifest = tomllib.loads(path.read_text())
        if room(path) not in ("fuzz", "python", "lab"):
            for kind in ("dependencies", "dev-dependencies", "build-dependencies"):
                names |= set(manifest.get(kind, {}))
    return len(names - {room(path) for path in manifests})


def n_equal_passages(paths: list[Path]) -> int:
    """Counts passages of product code that occur twice; passages that overlap count once."""
    places: dict[tuple[str, ...], list[tuple[Path, int]]] = collections.defaultdict(list)
    for path in paths:
        lines = code_of(path.read_text())
        for at in range(len(lines) - N_EQUAL + 1):
            places[tuple(lines[at : at + N_EQUAL])].append((path, at))
    twice = {place for found in places.values() if len(found) > 1 for place in found[1:]}
    return sum((path, at - 1) not in twice for path, at in twice)


def main() -> int:
    rust = [path for path in tracked("*.rs") if room(path) != "lab"]
    product = [path for path in rust if not is_test(path)]
    by_room: collections.Counter[str] = collections.Counter()
    for path in rust:
        by_room[room(path)] += len(path.read_text().splitlines())
    n_lines = by_room.total()
    name, largest = by_room.most_common(1)[0]
    counts = {
        "lines of Rust outside lab/": n_lines,
        "of it without tests and comments": sum(len(code_of(path.read_text())) for path in product),
        "settings": n_settings(rust),
        "commands": n_commands(),
        "words on pages": n_words(),
        "largest room, % of all Rust": round(100 * largest / n_lines),
        "direct dependencies": n_dependencies(),
        "passages of 12 equal lines": n_equal_passages(product),
        "lines of README.md": len((ROOT / "README.md").read_text().splitlines()),
    }
    passed = []
    for what, count in counts.items():
        limit = max(GOALS[what], CEILINGS.get(what, 0))
        state = "ok" if count <= GOALS[what] else "not yet" if count <= limit else "GREW"
        print(f"{what:34} {count:>7,}  goal {GOALS[what]:>7,}  {state}")
        passed += [what] if count > limit else []
    print(f"the largest room is {name}, with {largest:,} lines")
    return 1 if passed else 0


if __name__ == "__main__":
    sys.exit(main())

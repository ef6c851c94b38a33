#!/usr/bin/env python3
"""Makes the pictures of the web page in docs/ again, page.png and draw.png, or looks at all its main states.

    python3 lab/screenshots.py --binary target/release/lodestone [--driver /usr/bin/chromedriver]
    python3 lab/screenshots.py --binary target/release/lodestone --states target/pictures

It needs a chromedriver next to its Chromium. For docs/, a program that already runs is looked at with
`--address`. With `--states`, it trains for some minutes, keeps pictures of each state in the folder, and
fails if anything is wrong with one; it needs the axe-core that `.ci/run page` installs.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import pages
from pages import Album, Browser, Program

ROOT = Path(__file__).resolve().parents[1]
AXE = ROOT / "target/page/node_modules/axe-core/axe.min.js"
# Each is of a moment at which nothing moves.
DOCS = [
    ("page.png", "?blueprint=14_003&step=40", (1280, 960), "await shows(40);"),
    ("draw.png", "?blueprint=2_000&step=0&draw=open", (1280, 880), pages.DRAW),
]
PLAIN = ["--preset", "quickstart"]
SMALL = [*PLAIN, "--set", "evaluator.every.steps=4000", "--set", "evaluator.episodes.n_episodes=2"]
CLIPBOARD = ["clipboardReadWrite", "clipboardSanitizedWrite"]
TOKEN = "only-for-pictures"


def served(command: list[str], cwd: Path | None = None) -> Program:
    """Starts a program that prints the address of its page."""
    return Program(command, "page at ", "\n", cwd)


def take(browser: Browser, address: str) -> None:
    for name, query, size, script in DOCS:
        browser.size(*size)
        browser.open(f"{address}/{query}")
        browser.on_page(script)
        (ROOT / "docs" / name).write_bytes(browser.picture(is_whole=False))
        print(ROOT / "docs" / name)


def look_at_play(album: Album, binary: str, scratch: Path) -> None:
    downloads = scratch / "downloads"
    album.browser.devtools("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(downloads))
    album.browser.devtools("Browser.grantPermissions", permissions=CLIPBOARD)
    with served([binary, "play", "--no-open"], scratch) as play:
        album.show(pages.being_built, play.said, downloads)
        for state in pages.OF_PLAY:
            album.show(state, play.said)
        album.show(pages.server_gone, play.said, play, is_answered=False)


def look_without_webgl(album: Album, binary: str, scratch: Path) -> None:
    usual = album.browser
    with served([binary, "play", "--no-open"], scratch) as play, Browser(usual.port, "--disable-3d-apis") as plain:
        album.browser = plain
        album.show(pages.without_webgl, play.said, logs="WebGL")
        album.browser = usual


def look_at_training(album: Album, binary: str, scratch: Path) -> None:
    train = [binary, "train", "--steps", "1e6", "--seed", "1", "--web", "127.0.0.1:0"]
    with served([*train, *PLAIN, "--run-dir", "plain"], scratch) as run:
        album.show(pages.training, run.said)
    with served([*train, *SMALL, "--run-dir", "live"], scratch) as run:
        album.show(pages.training_evaluated, run.said)
        album.show(pages.training_ended, run.said, run, is_answered=False)


def look_at_runs(album: Album, binary: str, scratch: Path) -> None:
    grid = ["--steps", "12e3", "--seeds", "2", "--grid", "learner.gamma=0.9,0.97", "--out", "sweep"]
    subprocess.run([binary, "sweep", *SMALL, *grid], cwd=scratch, check=True, stdout=subprocess.DEVNULL)
    first, second = "sweep/point-1/seed-1", "sweep/point-2/seed-1"
    with served([binary, "serve", first], scratch) as one:
        album.show(pages.finished, one.said)
        album.show(pages.watch_it_learn, one.said)
    with served([binary, "serve", first, second], scratch) as two:
        album.show(pages.beside_each_other, two.said)
    with served([binary, "serve", "sweep"], scratch) as all_runs:
        album.show(pages.sweep, all_runs.said)
    with served([binary, "serve", first, "--token", TOKEN], scratch) as closed:
        album.show(pages.token_refused, closed.said, is_answered=False)


def look(browser: Browser, binary: str, folder: Path) -> int:
    """Keeps pictures of all states in the folder. Returns 1, with what is wrong, if anything is."""
    folder.mkdir(parents=True, exist_ok=True)
    album = Album(browser, folder, AXE.read_text())
    with tempfile.TemporaryDirectory() as scratch:
        for part in (look_at_play, look_without_webgl, look_at_training, look_at_runs):
            part(album, str(Path(binary).resolve()), Path(scratch))
    said = f"{album.n_states} states, pictures in {folder}; {len(album.faults)} faults"
    print(said, *album.faults, sep="\n  ")
    return 1 if album.faults else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--binary", default="target/release/lodestone")
    parser.add_argument("--driver", default="chromedriver")
    parser.add_argument("--address", help="of a page that is served already")
    parser.add_argument("--states", type=Path, metavar="DIR", help="keep pictures of all main states here")
    arguments = parser.parse_args()
    driver = Program([arguments.driver, "--port=0"], "successfully on port ", ".")
    with driver, Browser(driver.said) as browser:
        if arguments.states:
            return look(browser, arguments.binary, arguments.states)
        if arguments.address:
            take(browser, arguments.address)
            return 0
        with served([arguments.binary, "play", "--no-open"]) as play:
            take(browser, play.said)
    return 0


if __name__ == "__main__":
    sys.exit(main())

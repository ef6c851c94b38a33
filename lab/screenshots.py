#!/usr/bin/env python3
"""Makes the pictures of the web page in docs/ again: page.png and draw.png.

    python3 lab/screenshots.py --binary target/release/lodestone [--driver /usr/bin/chromedriver]

It needs a chromedriver next to its Chromium. A program that already runs is looked at with `--address` instead.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import json
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
OPTIONS = ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--force-prefers-reduced-motion"]
# Both wait for what they show; the picture is of a moment at which nothing moves.
MODULE = "const { editor, replay } = await import(new URL('app.js', document.baseURI).href);"
WAIT = "const until = async (holds) => { while (!holds()) await new Promise((go) => setTimeout(go, 50)); };"
PAGE = "await until(() => replay.episode && replay.time === 40);"
# A tile of the gatehouse, turned around, repels the bar beside it.
DRAW = """
    await until(() => document.querySelector('#draw-palette button'));
    editor.load(await (await fetch('/api/blueprint?id=12_000')).text());
    const says = (part, words) => until(() => document.querySelector(part).textContent.includes(words));
    await says('#draw-say', 'It can be built.');
    editor.pick(9);
    editor.act('turn');
    editor.act('turn');
    await says('#draw-problems', 'like poles meet');
    document.querySelector('#draw').scrollIntoView();
"""


@contextlib.contextmanager
def started(command: list[str], before: str, after: str) -> Iterator[str]:
    """Runs a program, and yields what it prints between two texts."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        line = next(line for line in process.stdout if before in line)
        yield line.split(before, 1)[1].split(after)[0].strip()
    finally:
        process.terminate()
        process.wait()


class Browser:
    def __init__(self, port: str) -> None:
        self.base = f"http://127.0.0.1:{port}/session"
        wanted = {"goog:chromeOptions": {"args": OPTIONS}}
        self.base += "/" + self.ask("", {"capabilities": {"alwaysMatch": wanted}})["sessionId"]

    def ask(self, path: str, body: dict | None = None) -> object:
        data = None if body is None else json.dumps(body).encode()
        with urllib.request.urlopen(urllib.request.Request(self.base + path, data)) as answer:
            return json.load(answer)["value"]

    def picture(self, address: str, size: tuple[int, int], script: str) -> bytes:
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
        self.ask("/goog/cdp/execute", {"cmd": "Emulation.setDeviceMetricsOverride", "params": metrics})
        self.ask("/timeouts", {"script": 120_000})
        self.ask("/url", {"url": address})
        body = f"return (async () => {{ {MODULE} {WAIT} {script} }})()"
        self.ask("/execute/sync", {"script": body, "args": []})
        return base64.b64decode(self.ask("/screenshot"))


def take(address: str, port: str) -> None:
    browser = Browser(port)
    shown = [
        ("page.png", "?blueprint=14_003&step=40", (1280, 960), PAGE),
        ("draw.png", "?blueprint=2_000&step=0&draw=open", (1280, 880), DRAW),
    ]
    for name, query, size, script in shown:
        (DOCS / name).write_bytes(browser.picture(f"{address}/{query}", size, script))
        print(DOCS / name)
    urllib.request.urlopen(urllib.request.Request(browser.base, method="DELETE")).close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--binary", default="target/release/lodestone")
    parser.add_argument("--driver", default="chromedriver")
    parser.add_argument("--address", help="of a page that is served already")
    arguments = parser.parse_args()
    play = [arguments.binary, "play", "--no-open", "--web", "127.0.0.1:0"]
    served = contextlib.nullcontext(arguments.address) if arguments.address else started(play, "page at ", "\n")
    with served as address, started([arguments.driver, "--port=0"], "successfully on port ", ".") as port:
        take(address, port)


if __name__ == "__main__":
    main()

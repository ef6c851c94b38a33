#!/usr/bin/env python3
"""Measures the time until `lodestone play` shows a moving structure in a browser.

Usage: python3 lab/benches/first_picture.py PROGRAM [--rounds N] [--driver CHROMEDRIVER]

Needs Chromium and its driver (Debian: chromium, chromium-driver). The browser runs headless and renders 3D in software,
so a machine with a GPU is faster. Prints the seconds of every round and the minimum of each column.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import time
import urllib.request
from pathlib import Path
from typing import Any

ARGS = ["--headless", "--no-sandbox", "--no-first-run", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
MOVES = "return typeof replay === 'object' && !document.querySelector('#replay-player').hidden && replay.time > 0"
POLL_S = 0.02


def ask(address: str, body: dict[str, Any] | None, method: str = "POST") -> Any:
    """Sends a request to the driver and returns the value of its response."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(address, data, {"Content-Type": "application/json"}, method=method)
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)["value"]


def printed(process: subprocess.Popen[str], before: str) -> str:
    """Returns the text after `before` in the first output line that contains it."""
    assert process.stdout is not None
    return next(line.split(before, 1)[1].strip() for line in process.stdout if before in line)


def measure(program: Path, session: str) -> tuple[float, float]:
    """Returns the seconds from program start to the printed page address, and from opening the page to first motion."""
    began = time.monotonic()
    command = [str(program), "play"]
    playing = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        address = printed(playing, "page at ")
        served = time.monotonic() - began
        began = time.monotonic()
        ask(f"{session}/url", {"url": address})
        while not ask(f"{session}/execute/sync", {"script": MOVES, "args": []}):
            time.sleep(POLL_S)
        return served, time.monotonic() - began
    finally:
        playing.terminate()
        playing.wait(60)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=Path, help="the program lodestone, release profile")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--driver", default="chromedriver")
    args = parser.parse_args()
    driver = subprocess.Popen([args.driver, "--port=0"], stdout=subprocess.PIPE, text=True)
    try:
        port = printed(driver, "successfully on port ").rstrip(".")
        wanted = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": {"args": ARGS}}}}
        session = f"http://127.0.0.1:{port}/session"
        session += "/" + ask(session, wanted)["sessionId"]
        rounds = []
        for _ in range(args.rounds):
            rounds.append(measure(args.program.resolve(), session))
            print("start to page {:.2f} s, page to motion {:.2f} s".format(*rounds[-1]), flush=True)
        ask(session, None, "DELETE")
        print("least: start to page {:.2f} s, page to motion {:.2f} s".format(*map(min, zip(*rounds, strict=True))))
    finally:
        driver.terminate()
        driver.wait(60)


if __name__ == "__main__":
    main()

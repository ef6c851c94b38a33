"""The main states of the web page in a browser: each is reached, checked, and kept as pictures.

`screenshots.py --states` runs this. A state is a function that brings the page there and requires what a user
reads there. Then the page is looked at in each of `LOOKS`: it must not scroll sideways, axe-core must find no
serious fault, and the browser must log no error.
"""

from __future__ import annotations

import base64
import json
import signal
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

# Browsers in containers run as root and have little shared memory.
OPTIONS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--force-prefers-reduced-motion",
]
PATIENCE_S = 300
# What a script on the page begins with.
PARTS = """
    const from = (name) => import(new URL(name, document.baseURI).href);
    const { editor, heat, replay, snapshots } = await from('app.js');
    const { model } = await from('model.js');
    const part = (name) => document.querySelector(name);
    const text = (name) => part(name)?.textContent ?? '';
    const until = async (holds) => { while (!holds()) await new Promise((go) => setTimeout(go, 50)); };
    const says = (name, words) => until(() => text(name).includes(words));
    const require = (is, wanted) => {
        if (JSON.stringify(is) !== JSON.stringify(wanted)) {
            throw new Error(`${JSON.stringify(is)} instead of ${JSON.stringify(wanted)}`);
        }
    };
    const shows = (step) => until(() => replay.episode && replay.time === Math.min(step, replay.n));
"""
# Charts take their size a moment after the window, and images of the gallery come into view.
SETTLE = """
    const wait = (ms) => new Promise((go) => setTimeout(go, ms));
    const isMissing = (image) => {
        const { top, bottom } = image.getBoundingClientRect();
        return top < innerHeight && bottom > 0 && image.naturalWidth === 0;
    };
    do await wait(500); while ([...document.images].some(isMissing));
"""
AXE = """
    const { violations } = await axe.run(document, { resultTypes: ['violations'] });
    const serious = violations.filter(({ impact }) => impact === 'serious' || impact === 'critical');
    return serious.flatMap(({ help, nodes }) => nodes.map(({ html }) => `${help}: ${html.slice(0, 160)}`));
"""
# Width, height, and color scheme, by the name that a picture's file ends with.
LOOKS = {
    "phone": (390, 844, "light"),
    "desktop": (1920, 1080, "light"),
    "dark": (1920, 1080, "dark"),
}
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"


class Failed(Exception):
    """The page is not as it should be."""


class Program:
    """A program that runs until the block ends, and what it printed between two texts."""

    def __init__(self, command: list[str], before: str, after: str, cwd: Path | None = None) -> None:
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=cwd)
        line = next(line for line in self.process.stdout if before in line)
        self.said = line.split(before, 1)[1].split(after)[0].strip()

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self.end(signal.SIGTERM)

    def end(self, how: signal.Signals) -> None:
        self.process.send_signal(how)
        self.process.wait()


class Browser:
    def __init__(self, port: str, *options: str) -> None:
        self.port = port
        self.base = f"http://127.0.0.1:{port}/session"
        wanted = {"goog:chromeOptions": {"args": [*OPTIONS, *options]}, "goog:loggingPrefs": {"browser": "ALL"}}
        self.base += "/" + self.ask("", {"capabilities": {"alwaysMatch": wanted}})["sessionId"]
        self.ask("/timeouts", {"script": 1000 * PATIENCE_S})

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        urllib.request.urlopen(urllib.request.Request(self.base, method="DELETE")).close()

    def ask(self, path: str, body: dict) -> object:
        request = urllib.request.Request(self.base + path, json.dumps(body).encode())
        try:
            with urllib.request.urlopen(request) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise Failed(json.load(error)["value"]["message"].splitlines()[0]) from None

    def devtools(self, command: str, **parameters: object) -> dict:
        return self.ask("/goog/cdp/execute", {"cmd": command, "params": parameters})

    def open(self, address: str) -> None:
        self.ask("/url", {"url": address})

    def run(self, body: str) -> object:
        """Runs the body of an asynchronous function on the page, and returns its result."""
        return self.ask("/execute/sync", {"script": f"return (async () => {{ {body} }})()", "args": []})

    def on_page(self, body: str) -> object:
        """Does the same where `PARTS` are known."""
        return self.run(PARTS + body)

    def click(self, selector: str) -> None:
        """Clicks as a user does, which alone may fill the screen or the clipboard."""
        found = self.ask("/element", {"using": "css selector", "value": selector})
        self.ask(f"/element/{found[ELEMENT]}/click", {})

    def point(self, x: int, y: int) -> None:
        """Moves the mouse away from what it clicked."""
        move = {"type": "pointerMove", "x": x, "y": y}
        self.ask("/actions", {"actions": [{"type": "pointer", "id": "mouse", "actions": [move]}]})

    def size(self, width: int, height: int) -> None:
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        self.devtools("Emulation.setDeviceMetricsOverride", **metrics)

    def scheme(self, scheme: str) -> None:
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.devtools("Emulation.setEmulatedMedia", features=features)

    def picture(self, is_whole: bool) -> bytes:
        """Returns the picture of the window, or of the whole page, which goes to its top for that."""
        size = "scrollTo(0, 0); return [innerWidth, Math.max(innerHeight, document.body.scrollHeight)]"
        whole: dict[str, object] = {}
        if is_whole:
            width, height = self.run(size)
            clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
            whole = {"captureBeyondViewport": True, "clip": clip}
        return base64.b64decode(self.devtools("Page.captureScreenshot", **whole)["data"])

    def errors(self) -> list[dict]:
        """Returns the errors that the browser has logged since the last call."""
        return [entry for entry in self.ask("/se/log", {"type": "browser"}) if entry["level"] == "SEVERE"]


class Album:
    """Keeps pictures of states, and what is wrong with them."""

    def __init__(self, browser: Browser, folder: Path, axe: str) -> None:
        self.browser = browser
        self.folder = folder
        self.axe = axe
        self.faults: list[str] = []
        self.n_states = 0

    def show(self, state: Callable[..., None], *place: object, is_answered: bool = True, logs: str = "") -> None:
        """Brings the page to a state and looks at it; `is_answered` says whether a server answers it.

        If the browser logs errors that are part of the state, they contain the text of `logs`.
        """
        self.n_states += 1
        # The page before may have lost its server since.
        self.browser.open("about:blank")
        self.browser.errors()
        name = state.__name__.replace("_", "-")
        self.browser.size(*LOOKS["desktop"][:2])
        self.browser.scheme("light")
        try:
            state(self.browser, *place)
            for look in LOOKS:
                self.look(name, look)
        except Failed as error:
            self.faults.append(f"{name}: {error}")
            self.keep(f"{name}-failed")
        logged = (entry for entry in self.browser.errors() if is_answered or entry["source"] != "network")
        logged = (entry for entry in logged if not logs or logs not in entry["message"])
        self.faults += [f"{name}: the browser logged {entry['message']}" for entry in logged]
        print(name, flush=True)

    def look(self, name: str, look: str) -> None:
        width, height, scheme = LOOKS[look]
        self.browser.size(width, height)
        self.browser.scheme(scheme)
        self.browser.run(SETTLE)
        self.keep(f"{name}-{look}")
        # The browser itself wraps what is no page.
        if self.browser.run("return document.contentType") == "text/html":
            self.faults += [f"{name}, {look}: {fault}" for fault in self.found(width)]

    def found(self, width: int) -> list[str]:
        """Returns what is wrong with the page in a window of this width."""
        if not self.browser.run("return 'axe' in window"):
            self.browser.run(self.axe)
        wide = self.browser.run("return document.documentElement.scrollWidth")
        sideways = [f"it is {wide} pixels wide"] if wide > width else []
        return sideways + self.browser.run(AXE)

    def keep(self, name: str) -> None:
        covers = "document.querySelector('dialog[open]') || document.fullscreenElement"
        is_covered = self.browser.run(f"return Boolean({covers})")
        (self.folder / f"{name}.png").write_bytes(self.browser.picture(is_whole=not is_covered))


def being_built(page: Browser, address: str, downloads: Path) -> None:
    page.open(f"{address}/?blueprint=14_003&step=40")
    page.on_page("""
        await shows(40);
        require(part('#replay-verdict').className, 'verdict open');
        require(/^Building: \\d+ of 25 connections after \\d+\\.\\d s$/.test(text('#replay-verdict')), true);
    """)
    page.click("#replay-save")
    picture = downloads / "14_003-policy-step-40.png"
    deadline = time.monotonic() + PATIENCE_S
    while not picture.exists():
        if time.monotonic() > deadline:
            raise Failed(f"Save picture made no {picture.name}")
        time.sleep(0.1)
    if not picture.read_bytes().startswith(b"\x89PNG"):
        raise Failed(f"{picture.name} is no picture")


def built(page: Browser, address: str) -> None:
    page.open(f"{address}/?blueprint=6_000&agent=expert&step=10")
    # The structure is turned upright once it has been played to its end.
    page.on_page("""
        await shows(10);
        replay.seek(replay.n - 1);
        part('#replay-play').click();
        await until(() => !replay.playing && replay.after >= 14);
        require(part('#replay-verdict').className, 'verdict good');
        require(/^Built: 6 of 6 connections in \\d+\\.\\d s$/.test(text('#replay-verdict')), true);
    """)


def not_built(page: Browser, address: str) -> None:
    # Whoever builds, this block is taken away too often.
    taken = "_".join(f"{step},2,2,2,0,0,0,0" for step in range(4, 100, 6))
    page.open(f"{address}/?blueprint=4_000&agent=expert&step=999&disturb={taken}")
    page.on_page("""
        await shows(999);
        require(part('#replay-verdict').className, 'verdict bad');
        require(text('#replay-verdict'), 'Not built: 2 of 3 connections, time is up; cube 3 is not in place');
    """)


def horizon(page: Browser, address: str) -> None:
    """Looks from low above the ground, where the picture shows the horizon."""
    page.open(f"{address}/?blueprint=14_003&step=40&camera=-0.6,-0.75,0.22")
    page.on_page("""
        await shows(40);
        require([new URL(location.href).searchParams.get('camera'), replay.follows], ['-0.6,-0.75,0.22', true]);
    """)


def without_webgl(page: Browser, address: str) -> None:
    page.open(f"{address}/?blueprint=6_000")
    page.on_page("""
        await says('#replay-note', 'This browser cannot draw in 3D (WebGL is off or missing)');
        await says('#replay-note', 'Save video needs no WebGL.');
        part('#stage-video').click();
        await says('#stage-shared', 'Making the video');
        await until(() => text('#stage-shared') === '');
    """)


def gallery(page: Browser, address: str) -> None:
    page.open(f"{address}/?blueprint=6_000&step=0&open=gallery")
    page.on_page("await until(() => document.querySelectorAll('#gallery button img').length > 100)")


def gallery_search(page: Browser, address: str) -> None:
    gallery(page, address)
    page.on_page("""
        const find = part('#gallery input');
        find.value = '16 blocks';
        find.dispatchEvent(new Event('input'));
        const tiles = [...document.querySelectorAll('#gallery button:has(img)')];
        require(tiles.length > 1 && tiles.every((tile) => tile.textContent.includes(', 16 blocks')), true);
    """)


# A tile of the gatehouse, turned around, repels the bar beside it.
DRAW = """
    await until(() => part('#draw-palette button'));
    editor.load(await (await fetch('/api/blueprint?id=12_000')).text());
    await says('#draw-say', 'It can be built.');
    editor.pick(9);
    editor.act('turn');
    editor.act('turn');
    await says('#draw-problems', 'like poles meet');
    part('#draw').scrollIntoView();
"""


def drawing_with_a_problem(page: Browser, address: str) -> None:
    page.open(f"{address}/?blueprint=2_000&step=0&draw=open")
    page.on_page(DRAW)


def side_by_side(page: Browser, address: str) -> None:
    page.open(f"{address}/?blueprint=12_000&both=1&step=30")
    page.on_page("""
        await shows(30);
        require(replay.views.map(({ episode }) => episode.actor), ['policy', 'expert']);
    """)


def attention(page: Browser, address: str) -> None:
    page.open(f"{address}/?blueprint=6_000&eye=0&step=12")
    page.on_page("""
        await shows(12);
        part('#replay-more').open = true;
        require(document.querySelectorAll('#replay-strip rect').length, 7 * (replay.n + 2));
    """)


def full_screen(page: Browser, address: str) -> None:
    page.open(f"{address}/?blueprint=14_003&step=40")
    page.on_page("await shows(40)")
    page.click("#replay-full")
    page.on_page("await until(() => document.fullscreenElement)")
    page.point(200, 200)
    page.on_page("""
        await until(() => part('#replay').clientHeight === innerHeight);
        require(part('#replay').clientWidth, innerWidth);
        const isSeen = (one) => one.childElementCount === 0 && one.checkVisibility({ opacityProperty: true });
        const seen = [...document.fullscreenElement.querySelectorAll('*')].filter(isSeen);
        require(seen.map(({ id }) => id), ['replay']);
    """)


def link_copied(page: Browser, address: str) -> None:
    page.open(f"{address}/?blueprint=6_000&seed=2&step=5")
    page.on_page("await shows(5)")
    page.click("#replay-link")
    page.on_page("""
        await says('#stage-shared', 'Copied.');
        require(await navigator.clipboard.readText(), location.href);
        require(new URL(location.href).search, '?blueprint=6_000&seed=2&step=5');
    """)


def link_shown(page: Browser, address: str) -> None:
    """Does what a page that is not encrypted does on another machine, which has no clipboard."""
    page.open(f"{address}/?blueprint=12_000&both=1&seed=2&step=5&goal=hidden")
    page.on_page("""
        await shows(5);
        Object.defineProperty(navigator, 'clipboard', { value: undefined });
        part('#replay-link').click();
        await until(() => part('#stage-shared code'));
        require(text('#stage-shared'), location.href);
    """)


def training(page: Browser, address: str) -> None:
    """Looks at a training after a while, in which its preset evaluates nothing."""
    page.open(address)
    page.on_page("""
        await until(() => model.learner?.elapsed_s > 15 && part('#health canvas') && text('#roster').includes('actor '));
        require(text('#state'), 'live');
        require(text('#health').startsWith('success in training'), true);
        await says('#tiles', 'in training, nothing evaluated yet');
        await says('#curves', 'No evaluation yet; the first comes after 100 k environment steps.');
        await until(() => replay.episode && snapshots.all.length > 0);
    """)


def training_evaluated(page: Browser, address: str) -> None:
    page.open(address)
    page.on_page("""
        await until(() => heat.evaluations?.length >= 2 && part('#groups tbody tr') && part('#health canvas'));
        await until(() => part('#videos figure') && text('#roster').includes('actor '));
        require(text('#state'), 'live');
    """)


def training_ended(page: Browser, address: str, run: Program) -> None:
    training_evaluated(page, address)
    run.end(signal.SIGINT)
    page.on_page("""
        await until(() => text('#state') === 'ended');
        await says('#farewell', 'The run has ended. The page keeps what it has until you reload it.');
        await says('#farewell code', ' serve live');
    """)


def server_gone(page: Browser, address: str, play: Program) -> None:
    page.open(f"{address}/?blueprint=6_000&step=12")
    page.on_page("await shows(12)")
    play.end(signal.SIGKILL)
    page.on_page("""
        await until(() => !part('#farewell').hidden);
        require(text('#state'), 'no answer');
        await says('#farewell', 'may have ended: nothing answers.');
    """)


def finished(page: Browser, address: str) -> None:
    page.open(address)
    page.on_page("""
        await until(() => text('#state') === 'finished' && part('#curves canvas') && part('#health canvas'));
        await until(() => part('#videos figure'));
        require(text('#origin-title'), 'What produced the run');
    """)


def watch_it_learn(page: Browser, address: str) -> None:
    page.open(f"{address}/?blueprint=2_000&seed=3&step=0")
    page.on_page("""
        await shows(0);
        await until(() => snapshots.all.length > 1);
        part('#snapshot-through').click();
        await until(() => replay.episode?.caption?.startsWith(`policy after ${snapshots.all[0]} steps`));
        require([snapshots.isThrough, part('#snapshot').value], [true, '0']);
        await until(() => text('#snapshot-text').startsWith('after '));
        replay.seek(Math.min(5, replay.n));
    """)


def beside_each_other(page: Browser, address: str) -> None:
    page.open(address)
    page.on_page("""
        await until(() => part('#curves canvas') && part('#health canvas') && text('#origin-title') !== '');
        require(text('#origin-title'), 'What differs between the runs');
        const [table] = document.querySelectorAll('#origin table');
        require(/^1 of \\d+ settings differ$/.test(table.caption.textContent), true);
        const rows = [...table.tBodies[0].rows].map((row) => [...row.cells].map((cell) => cell.textContent));
        require(rows.filter(([name]) => name.includes('.')), [['learner.gamma', '0.9', '0.97']]);
        require(rows.find(([name]) => name === 'seed'), ['seed', '1', '1']);
    """)


def sweep(page: Browser, address: str) -> None:
    page.open(address)
    page.on_page("""
        await until(() => document.querySelectorAll('#sweep .reading .dot').length > 1);
        const rows = [...document.querySelectorAll('#sweep tbody tr')].map((row) => row.cells[0].textContent);
        require(rows, ['learner.gamma=0.9', 'learner.gamma=0.97']);
    """)


def token_refused(page: Browser, address: str) -> None:
    page.open(address)
    said = page.run("return document.body.innerText")
    if said.strip() != "open the page with ?token=…, or send Authorization: Bearer …":
        raise Failed(f"without its token, the page says {said}")


# Those that need only the address of `play`.
OF_PLAY = (
    built,
    not_built,
    horizon,
    gallery,
    gallery_search,
    drawing_with_a_problem,
    side_by_side,
    attention,
    full_screen,
    link_copied,
    link_shown,
)

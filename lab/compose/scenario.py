"""The checks of a ring in containers, in the order in which they must run."""

import os
import shutil
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import bus
import monitoring
import records
from checks import Failed, Tally, require, until
from image import read_sources, remove_image, runtime_image
from ring import PRESET, Ring, crash, exit_code, inspect, stays_ended
from shell import run as shell

RUN = f"/runs/{PRESET}"

# Services that Docker restarts automatically.
ROLES = ("router", "learner", "actor", "evaluator")


def run(tally: Tally, binary: Path, composes: Sequence[Sequence[str]], keep: bool) -> None:
    """Runs all checks with each of the Compose commands in `composes`."""
    image = f"lodestone-test:{os.getpid()}"
    if not tally.check("the image is built", lambda: f"{runtime_image(binary, image) / 1e6:.0f} MB"):
        return
    try:
        tally.check("cargo finds every crate in the context", lambda: read_sources(image))
        tally.check("the image needs no shell and no root", lambda: _image_is_plain(image))
        for number, compose in enumerate(composes):
            print(f"\nwith {' '.join(compose)}", flush=True)
            with tempfile.TemporaryDirectory(prefix="lodestone-compose-") as folder:
                scenario = Scenario(tally, Ring(compose, f"lodestone-test-{os.getpid()}-{number}", image), Path(folder))
                scenario.play(keep)
    finally:
        if not (keep and tally.n_failed):
            remove_image(image)


def _image_is_plain(image: str) -> str:
    about = inspect(image)["Config"]
    require(about["User"] == "10001:10001", f"its user is {about['User']}")
    require(about["Healthcheck"]["Test"] == ["CMD", "lodestone", "healthcheck"], f"{about['Healthcheck']}")
    require(about["StopSignal"] == "SIGTERM", f"{about['StopSignal']}")
    hardened = ["--read-only", "--cap-drop=ALL", "--security-opt=no-new-privileges", "--network=none"]
    return shell(["docker", "run", "--rm", *hardened, image, "--version"]).strip()


class Scenario:
    """The checks of one ring."""

    def __init__(self, tally: Tally, ring: Ring, folder: Path) -> None:
        self.tally = tally
        self.ring = ring
        self.folder = folder
        self.keys = folder / "viewer"
        # Set once the ring has started, because its volumes do not exist before.
        self.run_folder = Path()
        self.endpoint = f"quic/127.0.0.1:{ring.bus_port}"
        tally.on_failure = self._show_logs

    def play(self, keep: bool) -> None:
        """Runs all checks and removes containers and volumes at the end."""
        try:
            if self.tally.check("one command starts the ring, and all of it is healthy", self.starts):
                self._work()
        finally:
            if not (keep and self.tally.n_failed):
                self.tally.check("`down --volumes` leaves nothing", self.leaves_nothing, always=True)

    def _work(self) -> None:
        check = self.tally.check
        check("containers have what they need and nothing more", self.is_hardened)
        check("each role has its own keys only", self.keys_are_apart)
        check("the bus refuses whoever has no keys", self.strangers_are_refused)
        check("the viewer's keys can be copied out, and success comes over the bus", self.tells_success)
        check("actors can be added and taken away", self.scales)
        check("the page's names and numbers suit the dashboard", lambda: monitoring.names_exist(self.ring))
        if shutil.which("prometheus") and shutil.which("promtool"):
            check("Prometheus's configuration is valid", monitoring.configuration_is_valid)
            check("Prometheus has values for every panel", lambda: monitoring.panels_have_values(self.ring))
        else:
            print("not run Prometheus is missing (package prometheus)", flush=True)
        for role in ROLES:
            check(f"the run goes on when the {role}'s process is killed", partial(self.survives_crash, role))
        check("an actor that was cut off comes back", partial(self.survives_cut, "actor"))
        check("the learner that was cut off comes back", partial(self.survives_cut, "learner"))
        check("the run goes on when the router is restarted", self.survives_router)
        check("actors hear that what they sent was taken, and it was", self.acknowledged_is_counted)
        check("`down` and `up` carry the run on without a step lost", self.carries_on)
        check("success is reached", self.succeeds)
        check("a learner that has its steps ends and is left alone", self.finishes)
        self._records()

    def _records(self) -> None:
        check = self.tally.check
        check("every trajectory that arrived has a verdict", lambda: records.verdicts_add_up(self._lives()))
        check("no step is counted twice or lost", lambda: records.steps_add_up(self._lives()))
        check("every checkpoint can be loaded and judged", self.checkpoints_load)
        check("the history of evaluations is whole", lambda: records.database_is_whole(self.run_folder / "eval.db"))

    def starts(self) -> str:
        self.ring.up()
        self.run_folder = self.ring.run_folder()
        self.ring.wait_healthy({"router": 1, "learner": 1, "actor": 2, "evaluator": 1})
        require(exit_code(self.ring.container("keys")) == 0, "the service `keys` failed")
        return f"{self.ring.wait_steps(0)} steps"

    def is_hardened(self) -> str:
        for role in ROLES:
            for container in self.ring.containers(role):
                host = inspect(container)["HostConfig"]
                require(host["ReadonlyRootfs"] and host["Init"], f"{role}: its root can be written, or it has no init")
                require(host["CapDrop"] == ["ALL"] and not host["CapAdd"], f"{role}: it has capabilities")
                require("no-new-privileges:true" in host["SecurityOpt"], f"{role}: {host['SecurityOpt']}")
                require(host["Memory"] > 0 and host["PidsLimit"] > 0, f"{role}: its memory or processes have no limit")
                for ports in host["PortBindings"].values():
                    require(all(port["HostIp"] == "127.0.0.1" for port in ports), f"{role}: {ports}")
        return self._memory()

    def _memory(self) -> str:
        containers = [container for role in ROLES for container in self.ring.containers(role)]
        stats = shell(["docker", "stats", "--no-stream", "--format", "{{.Name}} {{.MemUsage}}", *containers])
        return ", ".join(
            f"{name.removeprefix(self.ring.project).strip('_-')} {used}"
            for name, used, *_ in (line.split() for line in stats.splitlines())
        )

    def keys_are_apart(self) -> None:
        for role in ROLES:
            mounts = inspect(self.ring.containers(role)[0])["Mounts"]
            names = {mount["Name"].removeprefix(f"{self.ring.project}_") for mount in mounts if "Name" in mount}
            expected = {f"keys-{role}"} | ({"runs"} if role in ("learner", "evaluator") else set())
            require(names == expected, f"{role} has {sorted(names)}")
            can_write = [mount["Destination"] for mount in mounts if mount["RW"] and mount["Destination"] != "/runs"]
            require(not can_write, f"{role} can write {can_write}")

    def strangers_are_refused(self) -> None:
        require(bus.is_refused(self.endpoint), "a client without keys was let in")

    def tells_success(self) -> str:
        self.ring.copy("keys", "/keys/viewer", self.folder)
        success = bus.success(self.endpoint, self.keys, PRESET, 120)["all"]["greedy"]["success"]
        return f"{success['n_successes']} of {success['n_episodes']} episodes"

    def scales(self) -> str:
        for n_actors in (4, 1, 2):
            self.ring.up("--scale", f"actor={n_actors}")
            self.ring.wait_alive("actor", n_actors)
        return f"4, 1 and 2 actors; {self.ring.keeps_learning()} steps"

    def survives_crash(self, role: str) -> str:
        n_lives, saved = len(self._lives()), self._saved()
        n_restarts = crash(self.ring.containers(role)[0])
        n_actors = len(self.ring.containers("actor"))
        self.ring.wait_alive("actor", n_actors)
        self.ring.wait_alive("learner", 1)
        self.ring.wait_healthy({role: n_actors if role == "actor" else 1})
        began = f", from {self._goes_on_from(n_lives, saved)} steps" if role == "learner" else ""
        return f"started again {n_restarts} times{began}; {self.ring.keeps_learning()} steps"

    def _goes_on_from(self, n_lives: int, saved: int) -> int:
        """Waits for a new learner's first update and returns its starting step. Fails if saved steps are lost."""
        life = until("the new learner's first update", 90, lambda: self._lives()[n_lives:])[0]
        require(life.began_with >= saved, f"{saved} steps were saved, and it went on from {life.began_with}")
        return life.began_with

    def survives_cut(self, role: str) -> str:
        container, network = self.ring.containers(role)[0], f"{self.ring.project}_bus"
        n_alive, n_restarts = self.ring.n_alive(role), inspect(container)["RestartCount"]
        shell(["docker", "network", "disconnect", network, container])
        try:
            self.ring.wait_alive(role, n_alive - 1)
        finally:
            shell(["docker", "network", "connect", network, container])
        self.ring.wait_alive(role, n_alive)
        require(inspect(container)["RestartCount"] == n_restarts, "it had to be started again")
        return f"{self.ring.keeps_learning()} steps"

    def survives_router(self) -> str:
        self.ring.compose("restart", "router")
        self.ring.wait_alive("actor", 2)
        self.ring.wait_alive("learner", 1)
        return f"{self.ring.keeps_learning()} steps"

    def acknowledged_is_counted(self) -> str:
        # Restart both, so that the actors' counters cover this learner only.
        self.ring.compose("restart", "learner", "actor")
        self.ring.wait_alive("actor", 2)
        self.ring.keeps_learning()

        def told() -> int:
            actors = bus.latest(self.endpoint, self.keys, f"lodestone/{PRESET}/metrics/actor/*")
            return sum(actor["n_trajectories_acked"] for actor in actors) if len(actors) == 2 else 0

        n_told = until("numbers of two actors", 60, told)
        # Wait for an update that began after the actors published their numbers.
        for _ in range(2):
            self.ring.keeps_learning()
        [learner] = bus.latest(self.endpoint, self.keys, f"lodestone/{PRESET}/metrics/learner")
        n_taken = learner["ingest"]["accepted_total"] + learner["ingest"]["duplicates_total"]
        require(n_taken >= n_told, f"actors were told of {n_told}, the learner counts {n_taken}")
        return f"actors were told of {n_told}, the learner counted {n_taken} soon after"

    def carries_on(self) -> str:
        self.ring.compose("stop", "actor", "learner")
        require(exit_code(self.ring.container("learner")) == 0, "the learner did not end well")
        lives, saved = self._lives(), self._saved()
        require(lives[-1].ended_with == saved, f"{lives[-1].ended_with} steps were consumed and {saved} saved")
        self.ring.down()
        self.ring.up()
        self.ring.wait_healthy({"router": 1, "learner": 1, "actor": 2, "evaluator": 1})
        began = self._goes_on_from(len(lives), saved)
        require(began == saved, f"{saved} steps were saved and the run went on from {began}")
        return f"from {saved} steps to {self.ring.wait_steps(saved)}"

    def succeeds(self) -> str:
        def often() -> str:
            success = bus.success(self.endpoint, self.keys, PRESET, 60)["all"]["greedy"]["success"]
            if success["rate"] < 0.5:
                raise Failed(f"a rate of {success['rate']}")
            return f"{success['n_successes']} of {success['n_episodes']} episodes"

        return until("half of the episodes succeed", 240, often)

    def finishes(self) -> str:
        saved = self._saved()
        self.ring.compose("stop", "learner")
        self.ring.up("learner", steps=1)
        learner = self.ring.container("learner")
        require(exit_code(learner) == 0, f"it ended with {exit_code(learner)}")
        stays_ended(learner, 5)
        require(self._saved() >= saved, "steps were lost")
        self.ring.compose("stop")
        return f"{self._saved()} steps"

    def checkpoints_load(self) -> str:
        records.nothing_is_left_over(self.run_folder)
        steps = records.saved_steps(self.run_folder)
        require(steps, "there is none")
        mount = f"{self.ring.project}_runs:/runs:ro"
        for saved in steps:
            judged = ["eval", "--checkpoint", f"{RUN}/checkpoints/step-{saved}", "--episodes", "1", "--json"]
            shell(["docker", "run", "--rm", "--network=none", "--volume", mount, self.ring.image, *judged])
        return f"steps {', '.join(map(str, steps))}"

    def leaves_nothing(self) -> None:
        def is_down() -> bool:
            self.ring.down("--volumes")
            return True

        # On a very busy machine, a container may take longer to stop than the daemon waits.
        until("`down`", 120, is_down)
        mine = f"label=com.docker.compose.project={self.ring.project}"
        for kind in ("container", "network", "volume"):
            left = shell(["docker", kind, "ls", "--quiet", "--filter", mine]).split()
            require(not left, f"{kind}s are left: {left}")

    def _lives(self) -> list[records.Life]:
        return records.lives(self.run_folder / "metrics.jsonl")

    def _saved(self) -> int:
        """Returns the steps of the newest checkpoint, or 0 if there is none."""
        return max(records.saved_steps(self.run_folder), default=0)

    def _show_logs(self) -> None:
        print(self.ring.logs(), flush=True)

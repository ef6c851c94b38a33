"""The checks of a ring in containers, in the order in which they must run."""

import json
import shutil
import sys
from functools import partial
from pathlib import Path

from ..ring import bus, records
from ..ring.checks import Tally, require
from ..ring.processes import ROOT, run
from . import monitoring
from .ring import PRESET, Ring, crash, exit_code, inspect, stays_ended, wait

# Services that Docker restarts automatically.
ROLES = ("router", "learner", "actor", "evaluator")

ALL = {"router": 1, "learner": 1, "actor": 2, "evaluator": 1}

# Upper bound on an actor's trajectories in flight, and so on those received but without a verdict.
UNDER_WAY = 64


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
        tally.on_failure = lambda: print(ring.compose("logs", "--no-color", "--tail=6"), flush=True)

    def play(self, keep: bool) -> None:
        """Runs all checks and removes containers and volumes at the end."""
        try:
            if self.tally.check("one command starts the ring, and all of it is healthy", self.starts):
                self.work()
        finally:
            if not (keep and self.tally.n_failed):
                self.tally.check("`down --volumes` leaves nothing", self.leaves_nothing, always=True)

    def work(self) -> None:
        check, ring = self.tally.check, self.ring
        check("containers have what they need and nothing more", self.is_hardened)
        check("each role has its own keys only", self.keys_are_apart)
        check("the bus refuses whoever has no keys", lambda: require(bus.is_refused(self.endpoint), "it let one in"))
        check("the viewer's keys can be copied out, and success comes over the bus", self.tells_success)
        check("actors can be added and taken away", self.scales)
        check("the page's names and numbers suit the dashboard", lambda: monitoring.names_exist(ring))
        if shutil.which("prometheus") and shutil.which("promtool"):
            check("Prometheus's configuration is valid", monitoring.configuration_is_valid)
            check("Prometheus has values for every panel", lambda: monitoring.panels_have_values(ring))
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
        check("every trajectory that arrived has a verdict", lambda: records.verdicts_add_up(self.lives(), 0, UNDER_WAY))
        check("no step is counted twice or lost", lambda: records.updates_add_up(self.lives()))
        check("every checkpoint can be loaded and evaluated", self.checkpoints_load)
        check("the history of evaluations is whole", lambda: records.database_is_whole(self.run_folder))

    def lives(self) -> list[records.Life]:
        return records.lives(self.run_folder)

    def saved(self) -> int:
        return records.saved_steps(self.run_folder)

    def starts(self) -> str:
        self.ring.up()
        self.run_folder = self.ring.run_folder()
        self.ring.wait_healthy(ALL)
        require(exit_code(self.ring.container("keys")) == 0, "the service `keys` failed")
        return f"{self.ring.wait_steps(0)} steps"

    def is_hardened(self) -> None:
        for role, container in [(role, container) for role in ROLES for container in self.ring.containers(role)]:
            host = inspect(container)["HostConfig"]
            require(host["ReadonlyRootfs"] and host["Init"], f"{role}: its root can be written, or it has no init")
            require(host["CapDrop"] == ["ALL"] and not host["CapAdd"], f"{role}: it has capabilities")
            require("no-new-privileges:true" in host["SecurityOpt"], f"{role}: {host['SecurityOpt']}")
            require(host["Memory"] > 0 and host["PidsLimit"] > 0, f"{role}: its memory or processes have no limit")
            for ports in host["PortBindings"].values():
                require(all(port["HostIp"] == "127.0.0.1" for port in ports), f"{role}: {ports}")

    def keys_are_apart(self) -> None:
        for role in ROLES:
            mounts = inspect(self.ring.containers(role)[0])["Mounts"]
            names = {mount["Name"].removeprefix(f"{self.ring.project}_") for mount in mounts if "Name" in mount}
            expected = {f"keys-{role}"} | ({"runs"} if role in ("learner", "evaluator") else set())
            require(names == expected, f"{role} has {sorted(names)}")
            can_write = [mount["Destination"] for mount in mounts if mount["RW"] and mount["Destination"] != "/runs"]
            require(not can_write, f"{role} can write {can_write}")

    def tells_success(self) -> str:
        run(["docker", "cp", f"{self.ring.container('keys')}:/keys/viewer", self.folder])
        return self.success(120)[1]

    def success(self, seconds: float) -> tuple[float, str]:
        """Returns the rate of the newest complete evaluation, using the client in deploy/examples, and says it."""
        client = [sys.executable, str(ROOT / "deploy/examples/success.py"), self.endpoint, "--once"]
        told = run([*client, "--run", PRESET, "--keys", str(self.keys)], seconds=seconds)
        success = json.loads(told)["all"]["sampled"]["success"]
        return success["rate"], f"{success['n_successes']} of {success['n_episodes']} episodes"

    def scales(self) -> str:
        for n_actors in (4, 1, 2):
            self.ring.up("--scale", f"actor={n_actors}")
            self.ring.wait_alive("actor", n_actors)
        return f"4, 1 and 2 actors; {self.ring.keeps_learning()} steps"

    def survives_crash(self, role: str) -> str:
        """Kills a role's process. A learner goes on from its newest checkpoint."""
        n_lives, saved = len(self.lives()), self.saved()
        n_restarts = crash(self.ring.containers(role)[0])
        n_actors = len(self.ring.containers("actor"))
        self.ring.wait_alive("actor", n_actors)
        self.ring.wait_alive("learner", 1)
        self.ring.wait_healthy({role: n_actors if role == "actor" else 1})
        began = f", from {self.goes_on_from(n_lives, saved)} steps" if role == "learner" else ""
        return f"started again {n_restarts} times{began}; {self.ring.keeps_learning()} steps"

    def goes_on_from(self, n_lives: int, saved: int) -> int:
        """Waits for a new learner's first update and returns its starting step. Fails if saved steps are lost."""
        life = wait("the new learner's first update", 90, lambda: self.lives()[n_lives:])[0]
        require(life.began_with >= saved, f"{saved} steps were saved, and it went on from {life.began_with}")
        return life.began_with

    def survives_cut(self, role: str) -> str:
        """Cuts a container from the network and connects it again. It must come back by itself."""
        container, network = self.ring.containers(role)[0], f"{self.ring.project}_bus"
        n_alive, n_restarts = self.ring.n_alive(role), inspect(container)["RestartCount"]
        run(["docker", "network", "disconnect", network, container])
        try:
            self.ring.wait_alive(role, n_alive - 1)
        finally:
            run(["docker", "network", "connect", network, container])
        self.ring.wait_alive(role, n_alive)
        require(inspect(container)["RestartCount"] == n_restarts, "it had to be started again")
        return f"{self.ring.keeps_learning()} steps"

    def survives_router(self) -> str:
        self.ring.compose("restart", "router")
        self.ring.wait_alive("actor", 2)
        self.ring.wait_alive("learner", 1)
        return f"{self.ring.keeps_learning()} steps"

    def acknowledged_is_counted(self) -> str:
        self.ring.compose("restart", "learner", "actor")
        self.ring.wait_alive("actor", 2)
        self.ring.keeps_learning()

        def told() -> int:
            actors = bus.latest(self.endpoint, self.keys, f"lodestone/{PRESET}/metrics/actor/*")
            return sum(actor["n_trajectories_acked"] for actor in actors) if len(actors) == 2 else 0

        n_told = wait("numbers of two actors", 60, told)
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
        lives, saved = self.lives(), self.saved()
        require(lives[-1].ended_with == saved, f"{lives[-1].ended_with} steps were consumed and {saved} saved")
        self.ring.down()
        self.ring.up()
        self.ring.wait_healthy(ALL)
        began = self.goes_on_from(len(lives), saved)
        require(began == saved, f"{saved} steps were saved and the run went on from {began}")
        return f"from {saved} steps to {self.ring.wait_steps(saved)}"

    def succeeds(self) -> str:

        def often() -> str:
            rate, said = self.success(60)
            require(rate >= 0.5, f"a rate of {rate}")
            return said

        return wait("half of the episodes succeed", 240, often)

    def finishes(self) -> str:
        """Gives the learner no steps to go. It must exit with 0, and Docker must not start it again."""
        saved = self.saved()
        self.ring.compose("stop", "learner")
        self.ring.up("learner", steps=1)
        learner = self.ring.container("learner")
        code = exit_code(learner)
        require(code == 0, f"it ended with {code}")
        stays_ended(learner, 5)
        require(self.saved() >= saved, "steps were lost")
        self.ring.compose("stop")
        return f"{self.saved()} steps"

    def checkpoints_load(self) -> str:
        steps = records.checkpoints_are_whole(self.run_folder)
        mount = f"{self.ring.project}_runs:/runs:ro"
        program = ["docker", "run", "--rm", "--network=none", "--volume", mount, self.ring.image]
        for saved in steps:
            checkpoint = f"/runs/{PRESET}/checkpoints/step-{saved}"
            run([*program, "eval", "--checkpoint", checkpoint, "--episodes", "1", "--json"])
        return f"steps {', '.join(map(str, steps))}"

    def leaves_nothing(self) -> None:
        """Removes everything. On a very busy machine, a container may take longer to stop than the daemon waits."""

        def is_down() -> bool:
            self.ring.down("--volumes")
            return True

        wait("`down`", 120, is_down)
        mine = f"label=com.docker.compose.project={self.ring.project}"
        for kind in ("container", "network", "volume"):
            left = run(["docker", kind, "ls", "--quiet", "--filter", mine]).split()
            require(not left, f"{kind}s are left: {left}")

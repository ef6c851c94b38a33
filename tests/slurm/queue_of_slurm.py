"""What Slurm says about jobs and nodes."""

from __future__ import annotations

import subprocess

from wait import wait_for


def slurm(*command: str) -> str:
    """Runs a command of Slurm; its output."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise AssertionError(f"{' '.join(command)} ended with {done.returncode}: {done.stdout}{done.stderr}")
    return done.stdout


def job(job_id: str) -> dict[str, str]:
    """The fields of a job, or of the first task of an array."""
    shown = slurm("scontrol", "show", "job", "--oneliner", job_id).splitlines()[0]
    return dict(word.split("=", 1) for word in shown.split() if "=" in word)


def state(job_id: str) -> str:
    """State of a job, such as RUNNING."""
    return job(job_id)["JobState"]


def tasks(array: str) -> dict[str, tuple[str, str]]:
    """State and node of each task of an array that is in the queue."""
    listed = slurm("squeue", "-h", "--array", "-j", array, "-o", "%i|%T|%N")
    rows = [line.split("|") for line in listed.splitlines()]
    return {task: (task_state, node) for task, task_state, node in rows}


def running(array: str) -> dict[str, str]:
    """Nodes of the running tasks of an array."""
    return {task: node for task, (task_state, node) in tasks(array).items() if task_state == "RUNNING"}


def restarts(job_id: str) -> int:
    """How often a job was put back into the queue."""
    return int(job(job_id)["Restarts"])


def node_is_down(node: str) -> bool:
    """Whether the controller has given up on a node."""
    return "DOWN" in node_flags(node)


def node_works(node: str) -> bool:
    """Whether a node answers and may be given work."""
    return not node_flags(node) & {"DOWN", "DRAIN", "NOT_RESPONDING", "FAIL", "UNKNOWN"}


def node_flags(node: str) -> set[str]:
    """State of a node and the flags that qualify it."""
    shown = slurm("scontrol", "show", "node", "--oneliner", node)
    state_of_node = next(word for word in shown.split() if word.startswith("State="))
    return set(state_of_node.removeprefix("State=").replace("*", "+NOT_RESPONDING").split("+"))


def is_queued(job_id: str) -> bool:
    """Whether a job has not ended."""
    listed = subprocess.run(["squeue", "-h", "-j", job_id, "-o", "%T"], capture_output=True, text=True, check=False)
    return listed.stdout.strip() not in ("", "COMPLETED", "CANCELLED", "FAILED")


def cancel_all() -> None:
    """Ends every job and waits until none is left."""
    slurm("scancel", "--user=root")
    wait_for("no job is left", lambda: not slurm("squeue", "-h"), 60)

"""Queries Slurm for the states of jobs and nodes."""

from ..ring.checks import until
from ..ring.processes import attempt, run


def slurm(*command: str) -> str:
    return run(command)


def job(job_id: str) -> dict[str, str]:
    """Returns the fields of a job or of an array's first task."""
    shown = slurm("scontrol", "show", "job", "--oneliner", job_id).splitlines()[0]
    return dict(word.split("=", 1) for word in shown.split() if "=" in word)


def state(job_id: str) -> str:
    return job(job_id)["JobState"]


def tasks(array: str) -> dict[str, tuple[str, str]]:
    """Returns the state and node of each task of a queued array."""
    rows = [line.split("|") for line in slurm("squeue", "-h", "--array", "-j", array, "-o", "%i|%T|%N").splitlines()]
    return {task: (task_state, node) for task, task_state, node in rows}


def running(array: str) -> dict[str, str]:
    """Returns the node of each running task of an array."""
    return {task: node for task, (task_state, node) in tasks(array).items() if task_state == "RUNNING"}


def restarts(job_id: str) -> int:
    """Returns the number of times a job was requeued."""
    return int(job(job_id)["Restarts"])


def node_is_down(node: str) -> bool:
    """Returns whether the controller has marked a node down."""
    return "DOWN" in node_flags(node)


def node_works(node: str) -> bool:
    """Returns whether a node responds and can be assigned work."""
    return not node_flags(node) & {"DOWN", "DRAIN", "NOT_RESPONDING", "FAIL", "UNKNOWN"}


def node_flags(node: str) -> set[str]:
    """Returns the state and flags of a node."""
    shown = slurm("scontrol", "show", "node", "--oneliner", node)
    state_of_node = next(word for word in shown.split() if word.startswith("State="))
    return set(state_of_node.removeprefix("State=").replace("*", "+NOT_RESPONDING").split("+"))


def is_queued(job_id: str) -> bool:
    """Returns whether a job has not ended."""
    listed = attempt(["squeue", "-h", "-j", job_id, "-o", "%T"]).stdout
    return listed.strip() not in ("", "COMPLETED", "CANCELLED", "FAILED")


def cancel_all() -> None:
    """Cancels every job and waits until none is left."""
    slurm("scancel", "--user=root")
    until("no job is left", 60, lambda: not slurm("squeue", "-h"))

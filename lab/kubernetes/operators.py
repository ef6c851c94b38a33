"""What operators do with the run: its learner ends once, its page is scraped, and its alerts can fire."""

import re
from collections.abc import Iterator
from pathlib import Path

import promql_parser

from ..ring.processes import ROOT
from .manifests import Object, Workload, names, of_kind, ports_of, selects, workloads
from .rules import different

# The page's metrics, which Prometheus gets, are named in its source without this prefix and, for counters, this suffix.
PAGE = ROOT / "dashboard/src/web/prometheus.rs"
METRIC = re.compile(r"\blodestone_(\w+?)(?:_total)?\b")
UNFINISHED, FATAL = 75, {64, 67, 71}


def complaints(objects: list[Object]) -> Iterator[str]:
    """Yields what is wrong with the objects of operators, of which only the JobSet must be there."""
    yield from different("JobSets", names(objects, "JobSet"), ["run"])
    for thing in of_kind(objects, "JobSet"):
        yield from (f"the learner's end: {complaint}" for complaint in end(thing))
    pods = workloads(objects)
    for thing in of_kind(objects, "PodMonitor"):
        yield from (f"monitor: {complaint}" for complaint in scraped(thing["spec"], pods))
    groups = [group for thing in of_kind(objects, "PrometheusRule") for group in thing["spec"]["groups"]]
    for rule in (rule for group in groups for rule in group["rules"]):
        yield from (f"{rule['alert']}: {complaint}" for complaint in fires(rule["expr"], PAGE))


def end(jobset: Object) -> Iterator[str]:
    """Checks that the set is complete when the learner has its steps, and not when it is sent away before."""
    spec = jobset["spec"]
    [job] = spec["replicatedJobs"]
    yield from different("success policy", spec["successPolicy"].get("targetReplicatedJobs"), [job["name"]])
    [fatal, ignored, *_] = job["template"]["spec"]["podFailurePolicy"]["rules"]
    for rule, action, codes in ((fatal, "FailJob", FATAL), (ignored, "Ignore", {UNFINISHED})):
        yield from different(action, (rule["action"], set(rule["onExitCodes"]["values"])), (action, codes))
    pod = job["template"]["spec"]["template"]
    if "--fail-unfinished" not in pod["spec"]["containers"][0]["args"]:
        yield f"without --fail-unfinished it ends with 0, not {UNFINISHED}, when a node is drained"


def scraped(monitor: Object, pods: list[Workload]) -> Iterator[str]:
    """Checks that a PodMonitor leads to the evaluator's page with its token."""
    chosen = [pod for pod in pods if selects(monitor["selector"], pod.labels)]
    yield from different("pods", [pod.role for pod in chosen], ["evaluator"])
    for endpoint in monitor["podMetricsEndpoints"]:
        yield from (f"no port {endpoint['port']}" for pod in chosen if endpoint["port"] not in ports_of(pod))
        secret = endpoint["authorization"]["credentials"]
        yield from different("token", (secret["name"], secret["key"]), ("evaluator-page", "token"))


def fires(expression: str, page: Path) -> Iterator[str]:
    """Checks that Prometheus can read an expression, and that the page has its metrics."""
    try:
        promql_parser.parse(expression)
    except ValueError as error:
        yield str(error)
    there = page.read_text()
    yield from (f"the page has no {metric}" for metric in METRIC.findall(expression) if f'"{metric}"' not in there)

"""Runs Prometheus with the shipped configuration against the page, and checks the Grafana dashboard's queries."""

import json
import re
import tempfile
import urllib.error
import urllib.parse
import urllib.request
from functools import partial
from pathlib import Path
from typing import Any

from ..ring.checks import Failed, require
from ..ring.processes import ROOT, Process, free_port, run
from .ring import Ring, wait

FOLDER = ROOT / "deploy/monitoring"

# The scrape target in the shipped configuration, which only resolves inside the Compose network.
TARGET = "evaluator:8080"


def configuration_is_valid() -> str:
    """Checks that `promtool` accepts the configuration and returns the last line of its output."""
    return run(["promtool", "check", "config", FOLDER / "prometheus.yml"]).strip().splitlines()[-1].strip()


def expressions() -> list[tuple[str, str]]:
    """Returns the title and expression of every query on the dashboard."""
    dashboard = json.loads((FOLDER / "grafana/dashboards/lodestone.json").read_text())
    found = [(panel["title"], target["expr"]) for panel in dashboard["panels"] for target in panel.get("targets", [])]
    require(found, "the dashboard draws nothing")
    return found


def names_exist(ring: Ring) -> str:
    """Checks that the page has every metric that the dashboard uses."""
    page = ring.page("/metrics", host=TARGET)
    there = set(re.findall(r"^(lodestone_\w+)", page, re.MULTILINE))
    named = {name for _, expression in expressions() for name in re.findall(r"lodestone_\w+", expression)}
    require(named <= there, f"the page lacks {sorted(named - there)}")
    return f"{len(named)} of the page's {len(there)}"


def panels_have_values(ring: Ring) -> str:
    """Checks that Prometheus scrapes the page and returns values for every panel."""
    asked, port = expressions(), free_port()
    local = (FOLDER / "prometheus.yml").read_text()
    require(f'"{TARGET}"' in local, f"prometheus.yml does not scrape {TARGET}")
    local = local.replace(TARGET, f"127.0.0.1:{ring.page_port}")
    local = re.sub(r"(scrape_interval|scrape_timeout): \d+s", r"\1: 2s", local)
    with tempfile.TemporaryDirectory(prefix="lodestone-prometheus-") as folder:
        config = Path(folder) / "prometheus.yml"
        config.write_text(local)
        command = ["prometheus", f"--config.file={config}", f"--storage.tsdb.path={folder}/data"]
        server = Process([*command, f"--web.listen-address=127.0.0.1:{port}"], Path(folder) / "log")
        try:
            for title, expression in asked:
                # Grafana replaces these variables with a few scrape intervals and the selected run.
                text = expression.replace("$__rate_interval", "15s").replace("$run", ring.name())
                wait(f"values for `{title}` ({text})", 40, partial(query, port, text))
        except Failed as error:
            raise Failed(f"{error}\n{server.said()}") from None
        finally:
            server.kill()
    return f"{len(asked)} expressions"


def query(port: int, text: str) -> list[Any]:
    """Returns what Prometheus answers to a query."""
    address = f"http://127.0.0.1:{port}/api/v1/query?{urllib.parse.urlencode({'query': text})}"
    try:
        with urllib.request.urlopen(address, timeout=5) as answer:
            return list(json.load(answer)["data"]["result"])
    except urllib.error.HTTPError as error:
        raise Failed(error.read().decode(errors="replace")) from None

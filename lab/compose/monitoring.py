"""Runs Prometheus with the shipped configuration against the page, and checks the Grafana dashboard's queries."""

import contextlib
import json
import re
import subprocess
import tempfile
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from checks import Failed, require, until
from image import ROOT
from ring import Ring, free_port
from shell import run

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
    asked = expressions()
    with _prometheus(ring.page_port) as port:
        for title, expression in asked:
            # Grafana replaces these variables with a few scrape intervals and the selected run.
            query = expression.replace("$__rate_interval", "15s").replace("$run", ring.name())
            until(f"values for `{title}` ({query})", 40, partial(_query, port, query))
    return f"{len(asked)} expressions"


@contextlib.contextmanager
def _prometheus(page_port: int) -> Iterator[int]:
    """Runs a Prometheus server that scrapes the page and yields its port."""
    port = free_port()
    delivered = (FOLDER / "prometheus.yml").read_text()
    require(f'"{TARGET}"' in delivered, f"prometheus.yml does not scrape {TARGET}")
    local = delivered.replace(TARGET, f"127.0.0.1:{page_port}").replace("scrape_interval: 10s", "scrape_interval: 2s")
    local = local.replace("scrape_timeout: 5s", "scrape_timeout: 2s")
    with tempfile.TemporaryDirectory(prefix="lodestone-prometheus-") as folder:
        config, log = Path(folder) / "prometheus.yml", Path(folder) / "log"
        config.write_text(local)
        command = ["prometheus", f"--config.file={config}", f"--storage.tsdb.path={folder}/data"]
        with log.open("wb") as out:
            server = subprocess.Popen([*command, f"--web.listen-address=127.0.0.1:{port}"], stdout=out, stderr=subprocess.STDOUT)
        try:
            yield port
        except Failed as error:
            raise Failed(f"{error}\n{log.read_text(errors='replace')[-800:]}") from None
        finally:
            server.terminate()
            server.wait(30)


def _query(port: int, query: str) -> list[Any]:
    address = f"http://127.0.0.1:{port}/api/v1/query?{urllib.parse.urlencode({'query': query})}"
    try:
        with urllib.request.urlopen(address, timeout=5) as answer:
            return list(json.load(answer)["data"]["result"])
    except urllib.error.HTTPError as error:
        raise Failed(error.read().decode(errors="replace")) from None

"""Prints the dashboard's Prometheus metrics as JSON: name -> {"type": ..., "samples": [[name, labels, value], ...]}.

Usage: pip install prometheus-client; python scrape.py http://127.0.0.1:8080/metrics [TOKEN]

It uses the parser of the official Prometheus Python client, which rejects anything that OpenMetrics does not allow.
"""

import json
import sys
import urllib.request

from prometheus_client.openmetrics.parser import text_string_to_metric_families

headers = {"Authorization": f"Bearer {sys.argv[2]}"} if len(sys.argv) > 2 else {}
with urllib.request.urlopen(urllib.request.Request(sys.argv[1], headers=headers)) as answer:
    if not answer.headers["Content-Type"].startswith("application/openmetrics-text; version=1.0.0"):
        sys.exit(f"{answer.headers['Content-Type']} is another format")
    text = answer.read().decode()
families = text_string_to_metric_families(text)
print(json.dumps({f.name: {"type": f.type, "samples": [[s.name, s.labels, s.value] for s in f.samples]} for f in families}))

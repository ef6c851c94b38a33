"""Follows a run's success rates from Python: prints the latest summary at once, then every new one.

Usage: pip install eclipse-zenoh; python success.py tcp/127.0.0.1:7447 [--run NAME] [--once | --history]
       python success.py quic/127.0.0.1:7447 --keys KEYS [--run NAME] [--once | --history]

Requires a router (`lodestone router --listen tcp/127.0.0.1:7447`) and an evaluator that publishes summaries. For each
summary, prints one line per group for greedy and one for sampled actions. docs/metrics.md describes the JSON
fields.
"""

import argparse
import json
import pathlib
import queue

import zenoh

SCHEMA_VERSION = 2


def lines(summary):
    """Yields lines per group for greedy and sampled actions, or a warning if the schema is not supported."""
    if summary["schema_version"] != SCHEMA_VERSION:
        yield f"schema version {summary['schema_version']} is not {SCHEMA_VERSION}; fetch a newer success.py"
        return
    progress = "" if summary["is_complete"] else " so far"
    for group in [*summary["groups"], summary["all"]]:
        for acting in ("greedy", "sampled"):
            success = group[acting]["success"]
            if success["n_episodes"]:
                yield (
                    f"version {summary['weights_version']}  {summary['n_env_steps']} steps  "
                    f"{group['name']}, {acting}: {100 * success['rate']:.1f} % "
                    f"({100 * success['wilson_low']:.1f} to {100 * success['wilson_high']:.1f}) of {success['n_episodes']}{progress}"
                )


def show_keys(config, folder):
    """Configures mutual TLS and the password with the keys in `folder`."""
    if (folder / "viewer").is_dir():
        folder /= "viewer"
    config.insert_json5("transport/link/tls/root_ca_certificate", json.dumps(str(folder / "ca.pem")))
    config.insert_json5("transport/link/tls/connect_certificate", json.dumps(str(folder / "cert.pem")))
    config.insert_json5("transport/link/tls/connect_private_key", json.dumps(str(folder / "key.pem")))
    config.insert_json5("transport/link/tls/enable_mtls", "true")
    config.insert_json5("transport/link/tls/verify_name_on_connect", "true")
    user, _, password = (folder / "password").read_text().strip().partition(":")
    config.insert_json5("transport/auth/usrpwd", json.dumps({"user": user, "password": password}))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("endpoint", help="the router's, for example tcp/127.0.0.1:7447")
    parser.add_argument("--run", default="*", help="name of the run (`bus.run`, or the preset); all by default")
    parser.add_argument("--keys", metavar="DIR", type=pathlib.Path, help="folder of the role viewer, or of all roles, for quic/…")
    parser.add_argument("--once", action="store_true", help="print the first complete summary as JSON and end")
    parser.add_argument("--history", action="store_true", help="print all evaluations so far as JSON and end")
    args = parser.parse_args()

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([args.endpoint]))
    if args.keys:
        show_keys(config, args.keys)
    key = f"lodestone/{args.run}/metrics/eval/summary"
    samples = queue.SimpleQueue()
    with zenoh.open(config) as session:
        if args.history:
            for reply in session.get(f"lodestone/{args.run}/history/eval"):
                if reply.ok:
                    print(reply.ok.payload.to_string())
            return
        # Subscribe before the query so that no update is missed in between. The same value may then arrive twice.
        session.declare_subscriber(key, lambda sample: samples.put(sample.payload.to_string()))
        session.get(key, lambda reply: reply.ok and samples.put(reply.ok.payload.to_string()))
        while True:
            summary = json.loads(samples.get())
            if args.once:
                if summary["is_complete"]:
                    print(json.dumps(summary))
                    return
            else:
                print(*lines(summary), sep="\n", flush=True)


if __name__ == "__main__":
    main()

"""Logs a run to Weights & Biases or MLflow: every learner update, and the success per group of every evaluation.

Usage: pip install eclipse-zenoh wandb; python track.py tcp/127.0.0.1:7447 --to wandb [--run NAME] [--config runs/RUN/config.toml]
       pip install eclipse-zenoh mlflow; python track.py quic/127.0.0.1:7447 --keys KEYS --to mlflow
       python track.py runs/RUN --to mlflow

With an endpoint, it logs messages from the bus until Ctrl-C or SIGTERM. With a run folder, it logs the contents of
metrics.jsonl and exits. The step of every value is the number of environment steps. The tracker's own environment
variables choose the destination: WANDB_MODE=offline writes to ./wandb, MLFLOW_TRACKING_URI names a server or a
database. docs/metrics.md describes the fields.
"""

import argparse
import json
import pathlib
import queue
import signal
import tomllib

SCHEMA_VERSION = 2
# Not logged. The values per blueprint would make hundreds of curves.
LEFT_OUT = {"schema_version", "weights_version", "n_env_steps", "task_probabilities"}


def flat(tree, prefix=""):
    """Yields the leaves of nested dictionaries, with names such as ppo/entropy."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{name}/")
        else:
            yield prefix + name, value


def learner_values(update):
    """Yields the numeric values of a learner update."""
    tree = {name: value for name, value in update.items() if name not in LEFT_OUT}
    for name, value in flat(tree, "learner/"):
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            yield name, float(value)


def eval_values(summary):
    """Yields the success per group for greedy and sampled actions, named as in TensorBoard."""
    for group in [*summary["groups"], summary["all"]]:
        name = group["name"].replace(" ", "-")
        for acting in ("greedy", "sampled"):
            outcome = group[acting]
            if outcome["success"]["n_episodes"]:
                yield f"success-{acting}/{name}", outcome["success"]["rate"]
            if outcome["mean_steps_to_success"] is not None:
                yield f"steps-to-success-{acting}/{name}", outcome["mean_steps_to_success"]


def points(messages):
    """Yields the key, environment steps, and values by name of each `(key, value)` message, without duplicates."""
    known = set()
    for key, value in messages:
        if value["schema_version"] != SCHEMA_VERSION:
            print(f"{key}: schema version {value['schema_version']} is not {SCHEMA_VERSION}; fetch a newer track.py", flush=True)
            continue
        # Evaluations are also published while they are still in progress.
        if key == "eval/summary" and not value["is_complete"]:
            continue
        step = value["n_env_steps"]
        if (key, step, value["weights_version"]) not in known:
            known.add((key, step, value["weights_version"]))
            yield key, step, dict(learner_values(value) if key == "learner" else eval_values(value))


def recorded(folder):
    """Yields the messages recorded in a run folder. Counts and skips lines that a full disk or a power loss cut."""
    # A cut line may end within a character. The last part has no line break yet: the run goes on and writes it.
    *lines, _ = (folder / "metrics.jsonl").read_text(errors="replace").split("\n")
    n_broken = 0
    for line in lines:
        try:
            value = json.loads(line)
        except json.JSONDecodeError:
            n_broken += 1
            continue
        key = value.pop("key")
        if key in ("learner", "eval/summary"):
            yield key, value
    if n_broken:
        print(f"skipped {n_broken} broken lines of metrics.jsonl", flush=True)


def settings(file):
    """Reads a config.toml without the settings of the page, because its token is a secret."""
    config = tomllib.loads(file.read_text())
    config.pop("dashboard", None)
    return config


def live(endpoint, run, keys):
    """Yields the messages on the bus: the latest ones at once, then every new one. Never ends."""
    import zenoh
    from success import show_keys

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    if keys:
        show_keys(config, keys)
    samples = queue.SimpleQueue()
    with zenoh.open(config) as session:
        for key in ("learner", "eval/summary"):

            def put(sample, key=key):
                samples.put((key, json.loads(sample.payload.to_string())))

            # Subscribe before the query so that no update is missed in between.
            session.declare_subscriber(f"lodestone/{run}/metrics/{key}", put)
            session.get(f"lodestone/{run}/metrics/{key}", lambda reply, put=put: reply.ok and put(reply.ok))
        print("listening", flush=True)
        while True:
            yield samples.get()


class Wandb:
    """A Weights & Biases run."""

    def __init__(self, project, name, config):
        import wandb

        self.run = wandb.init(project=project, name=name, config=config)
        # W&B's own step must not decrease, but an evaluation may finish after later updates have been logged.
        self.run.define_metric("n_env_steps")
        self.run.define_metric("*", step_metric="n_env_steps")

    def log(self, step, values):
        self.run.log({"n_env_steps": step, **values})

    def close(self):
        self.run.finish()


class MLflow:
    """An MLflow run."""

    def __init__(self, project, name, config):
        import mlflow

        self.mlflow = mlflow
        mlflow.set_experiment(project)
        mlflow.start_run(run_name=name)
        mlflow.log_params({name.replace("/", "."): value for name, value in flat(config)})

    def log(self, step, values):
        self.mlflow.log_metrics(values, step=step)

    def close(self):
        self.mlflow.end_run()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", help="the router's endpoint, for example tcp/127.0.0.1:7447, or the folder of a run")
    parser.add_argument("--to", choices=["wandb", "mlflow"], required=True)
    parser.add_argument("--run", metavar="NAME", help="name of the run on the bus (`bus.run`, or the preset), needed if there are several")
    parser.add_argument("--keys", metavar="DIR", type=pathlib.Path, help="folder of the role viewer, or of all roles, for quic/…")
    parser.add_argument("--config", metavar="FILE", type=pathlib.Path, help="the run's config.toml, for its hyperparameters")
    parser.add_argument("--project", default="lodestone", help="project of Weights & Biases, or experiment of MLflow")
    args = parser.parse_args()

    folder = pathlib.Path(args.source)
    if folder.is_dir():
        name, messages, file = folder.name, recorded(folder), args.config or folder / "config.toml"
    else:
        name, messages, file = args.run, live(args.source, args.run or "*", args.keys), args.config
    config = settings(file) if file else {}
    # Schedulers and container runtimes stop processes with SIGTERM. Handle it like Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    tracker = (Wandb if args.to == "wandb" else MLflow)(args.project, name, config)
    try:
        for key, step, values in points(messages):
            tracker.log(step, values)
            print(f"{step} steps: {key}, {len(values)} numbers", flush=True)
    except KeyboardInterrupt:
        print("interrupted; what was logged stays", flush=True)
    finally:
        tracker.close()


if __name__ == "__main__":
    main()

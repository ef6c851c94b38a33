"""Follows a run into Weights & Biases or MLflow: each update of the learner, and success per group of each evaluation.

Usage: pip install eclipse-zenoh wandb; python track.py tcp/127.0.0.1:7447 --to wandb [--run NAME] [--config runs/RUN/config.toml]
       pip install eclipse-zenoh mlflow; python track.py quic/127.0.0.1:7447 --keys KEYS --to mlflow
       python track.py runs/RUN --to mlflow

With an endpoint it logs what comes over the bus until Ctrl-C or SIGTERM; with the folder of a run, what is in its metrics.jsonl, and ends. The
step of everything is the number of environment steps. Where it goes is for the other program's own variables to say:
WANDB_MODE=offline keeps it in ./wandb, MLFLOW_TRACKING_URI names a server or a database. The fields are described in
docs/metrics.md.
"""

import argparse
import json
import pathlib
import queue
import signal
import tomllib

SCHEMA_VERSION = 1
# Beside the numbers of each blueprint, which would be hundreds of curves.
LEFT_OUT = {"schema_version", "weights_version", "n_env_steps", "task_probabilities", "reverse_reach"}


def flat(tree, prefix=""):
    """The leaves of nested dictionaries, with names such as ppo/entropy."""
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{name}/")
        else:
            yield prefix + name, value


def learner_values(update):
    """The numbers of an update."""
    tree = {name: value for name, value in update.items() if name not in LEFT_OUT}
    for name, value in flat(tree, "learner/"):
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            yield name, float(value)


def eval_values(summary):
    """Success per group and way of acting, named as in TensorBoard."""
    for group in [*summary["groups"], summary["all"]]:
        name = group["name"].replace(" ", "-")
        for acting in ("mode", "sampled"):
            outcome = group[acting]
            if outcome["success"]["n_episodes"]:
                yield f"success-{acting}/{name}", outcome["success"]["rate"]
            if outcome["mean_steps_to_success"] is not None:
                yield f"steps-to-success-{acting}/{name}", outcome["mean_steps_to_success"]


def points(messages):
    """What to log of messages `(key, value)`: environment steps and numbers by name, nothing twice."""
    known = set()
    for key, value in messages:
        if value["schema_version"] != SCHEMA_VERSION:
            print(f"{key}: schema version {value['schema_version']} is not {SCHEMA_VERSION}; fetch a newer track.py", flush=True)
            continue
        # An evaluation is published while it runs as well.
        if key == "eval/summary" and not value["is_complete"]:
            continue
        step = value["n_env_steps"]
        if (key, step, value["weights_version"]) not in known:
            known.add((key, step, value["weights_version"]))
            yield key, step, dict(learner_values(value) if key == "learner" else eval_values(value))


def recorded(folder):
    """The messages in the folder of a run."""
    for line in (folder / "metrics.jsonl").read_text().splitlines(keepends=True):
        if not line.endswith("\n"):
            return  # The run goes on and writes it.
        value = json.loads(line)
        key = value.pop("key")
        if key in ("learner", "eval/summary"):
            yield key, value


def live(endpoint, run, keys):
    """The messages on the bus, the latest ones at once and then every new one, without end."""
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

            # Subscribed before it asks, so that nothing falls between the two.
            session.declare_subscriber(f"lodestone/{run}/metrics/{key}", put)
            session.get(f"lodestone/{run}/metrics/{key}", lambda reply, put=put: reply.ok and put(reply.ok))
        print("listening", flush=True)
        while True:
            yield samples.get()


class Wandb:
    """A run of Weights & Biases."""

    def __init__(self, project, name, config):
        import wandb

        self.run = wandb.init(project=project, name=name, config=config)
        # Not W&B's own step, which must not fall: an evaluation ends after later updates.
        self.run.define_metric("n_env_steps")
        self.run.define_metric("*", step_metric="n_env_steps")

    def log(self, step, values):
        self.run.log({"n_env_steps": step, **values})

    def close(self):
        self.run.finish()


class MLflow:
    """A run of MLflow."""

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
    config = tomllib.loads(file.read_text()) if file else {}
    # What stops a job or a container ends it as Ctrl-C does.
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

"""Prints what track.py logged as JSON: {"config": {...}, "metrics": {name: [[step, value], ...]}}.

Usage: python tracked.py wandb FOLDER_OF_A_RUN | mlflow FOLDER_OF_A_STORE
"""

import json
import os
import pathlib
import struct
import sys


BLOCK_BYTES = 32 * 1024
# Headers of the file and of each record fragment: checksum, length, and type (1 full, 2 first, 3 middle, 4 last).
FILE_HEADER, PIECE_HEADER = struct.Struct("<4sHB"), struct.Struct("<IHB")
WHOLE, LAST = 1, 4


def records(file):
    """Yields the records of a W&B file, which has the LevelDB log format."""
    data = file.read_bytes()
    at, record = FILE_HEADER.size, b""
    while at + PIECE_HEADER.size <= len(data):
        left = BLOCK_BYTES - at % BLOCK_BYTES
        if left < PIECE_HEADER.size:
            at += left
            continue
        _, length, piece = PIECE_HEADER.unpack_from(data, at)
        at += PIECE_HEADER.size
        record += data[at : at + length]
        at += length
        if piece in (WHOLE, LAST):
            yield record
            record = b""


def wandb(folder):
    """Reads the file of an offline run."""
    from wandb.proto import wandb_internal_pb2

    (file,) = folder.glob("wandb/offline-run-*/run-*.wandb")
    config, metrics = {}, {}
    for data in records(file):
        record = wandb_internal_pb2.Record.FromString(data)
        for update in record.run.config.update:
            config[update.key] = json.loads(update.value_json)
        row = {"".join(item.nested_key) or item.key: json.loads(item.value_json) for item in record.history.item}
        for name, value in row.items():
            if not name.startswith("_") and name != "n_env_steps":
                metrics.setdefault(name, []).append([row["n_env_steps"], value])
    return config, metrics


def mlflow(folder):
    """Reads the only run in a store."""
    # MLflow requires this opt-in for file stores.
    os.environ["MLFLOW_ALLOW_FILE_STORE"] = "true"
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri=folder.as_uri())
    (run,) = client.search_runs([e.experiment_id for e in client.search_experiments()])
    names = run.data.metrics
    history = {name: [[m.step, m.value] for m in client.get_metric_history(run.info.run_id, name)] for name in names}
    return run.data.params, history


config, metrics = {"wandb": wandb, "mlflow": mlflow}[sys.argv[1]](pathlib.Path(sys.argv[2]))
print(json.dumps({"config": config, "metrics": metrics}))

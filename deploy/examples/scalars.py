"""Prints the scalars in TensorBoard event files as JSON: tag -> list of [step, value].

Usage: pip install tensorboard; python scalars.py runs/<run>/tb/learner
"""

import json
import sys

from tensorboard.backend.event_processing.event_accumulator import SCALARS, EventAccumulator

# 0 keeps all events.
events = EventAccumulator(sys.argv[1], size_guidance={SCALARS: 0})
events.Reload()
print(json.dumps({tag: [[e.step, e.value] for e in events.Scalars(tag)] for tag in events.Tags()["scalars"]}))

"""Prints the animated images in TensorBoard event files as JSON: tag -> list of images with step and size.

Usage: pip install tensorboard; python pictures.py runs/<run>/tb/evaluator/videos
"""

import json
import sys

from tensorboard.backend.event_processing.event_accumulator import IMAGES, EventAccumulator


def about(event):
    """Describes an image: the format from the signature that browsers check, the size from the event."""
    picture = event.encoded_image_string
    # The logical screen of a GIF: width and height, little-endian, after the six-byte signature.
    screen = [int.from_bytes(picture[at : at + 2], "little") for at in (6, 8)]
    return {
        "step": event.step,
        "format": picture[:6].decode("latin-1"),
        "size": [event.width, event.height],
        "screen": screen,
        "n_bytes": len(picture),
    }


# 0 keeps all events.
events = EventAccumulator(sys.argv[1], size_guidance={IMAGES: 0})
events.Reload()
print(json.dumps({tag: [about(event) for event in events.Images(tag)] for tag in events.Tags()["images"]}))

"""Decodes a video with ffmpeg and prints its frame count, width and height, and frames per second as JSON.

Usage: pip install imageio-ffmpeg; python frames.py videos/<video>.mp4
"""

import json
import sys

import imageio_ffmpeg

frames = imageio_ffmpeg.read_frames(sys.argv[1], pix_fmt="rgb24")
about = next(frames)
width, height = about["size"]
sizes = [len(frame) for frame in frames]
assert all(size == 3 * width * height for size in sizes), "a frame was decoded in part"
print(json.dumps({"n_frames": len(sizes), "size": [width, height], "fps": about["fps"]}))

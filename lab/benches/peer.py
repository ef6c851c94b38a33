"""Times the peer networks the same way as `cargo bench -p lab --bench network` times ours.

Measures CPU time on one thread, takes the best of several rounds, and prints lines in the same format.
lab/benches/peers.py runs all of them.
"""

import time

N, ND, ED, GD = 16, 3, 24, 50
CASES = [("forward", 1), ("forward", 16), ("forward", 64), ("update", 64), ("update", 256)]
SECONDS = 4.0


def best(work, n):
    """Returns the least CPU-seconds per call of `work`, reading the clock once every `n` calls."""
    for _ in range(3):
        work()
    least, end = float("inf"), time.monotonic() + SECONDS
    while time.monotonic() < end:
        start = time.process_time()
        for _ in range(n):
            work()
        least = min(least, (time.process_time() - start) / n)
    return least


def report(kind, b, work):
    """Times `work` on a batch of `b` samples and prints the result."""
    seconds = best(work, max(64 // b, 1)) / b
    print(f"{kind} {b} {seconds * 1e3:.4f} ms/sample {1 / seconds:.0f} samples/s", flush=True)

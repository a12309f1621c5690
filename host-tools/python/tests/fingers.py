"""Virtual fingers for the tests."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

# Scans as fast as the product.
FAST = """
effects = ["noise"]

[scan]
rate_hz = 4000
duration_s = 2

[[press]]
at_s = 0.5
x_mm = 0.0
y_mm = 0.0
fz_n = 1.0
rise_s = 0.2
hold_s = 0.5
fall_s = 0.2
"""


@contextmanager
def serve(command: str, port: str, *arguments: str) -> Iterator[str]:
    """A virtual finger, and the port it can be reached at."""
    process = subprocess.Popen(
        [command, "serve", "--port", port, *arguments], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait(10)

"""Virtual fingers for the tests."""

import csv
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[3]
CALIBRATION = ROOT / "host-tools/cli/assets/virtual-finger.cal.toml"

# Scene at the product's scan rate.
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
    """Serves a virtual finger; yields its port."""
    process = subprocess.Popen(
        [command, "serve", "--port", port, *arguments], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait(10)


def replayed(command: str, scene: str, folder: Path) -> tuple[Path, dict[int, dict[str, str]]]:
    """Returns a trace of the scene, and `taxel replay`'s fields of it as text, by time."""
    trace, frames = folder / "trace.csv", folder / "frames.csv"
    simulate = [command, "simulate", "--scene", scene, "--seed", "3", "--out", str(trace)]
    subprocess.run(simulate, check=True, capture_output=True)
    core = [command, "replay", str(trace), "--calibration", str(CALIBRATION), "--fields", "all"]
    subprocess.run([*core, "--out", str(frames)], check=True, capture_output=True)
    return trace, {int(row["t_us"]): row for row in rows(frames)}


def rows(file: Path) -> Iterator[dict[str, str]]:
    """Yields a CSV's rows; the facts of a recording come before its header, after a #."""
    yield from csv.DictReader(line for line in file.open() if not line.startswith("#"))

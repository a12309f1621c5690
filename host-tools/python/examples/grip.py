"""Grip controller at 1 kHz: grips as hard as the friction needs, and no harder.

    python grip.py --port usb --seconds 10
    python grip.py --port sim:shear-ramp

The finger gives the normal force that leaves a third of the friction (``slip.grip_n``). The controller
follows it up at once and down slowly, and grips harder while the contact slips. A value that is missing or
too old never moves the grip. Replace :func:`command` by your gripper's driver.
"""

import argparse
import time

import numpy as np

import taxel
from taxel import Fields, Finger, Frame, Slip, StaleError, Status

STEP_S = 1e-3
LEAST_N, MOST_N = 0.2, 5.0
"""Range of the grip in newtons."""

LOOSEN_N_PER_S = 0.5
SLIP_N_PER_S = 20.0
MAX_AGE_S = 0.02
"""Age from which a frame no longer moves the grip."""


def next_grip(grip: float, frame: Frame) -> float:
    """Returns the grip in newtons after one step."""
    if not isinstance(frame.slip, Slip):
        return grip  # No contact, or a reason for a missing value: hold.
    wanted = max(frame.slip.grip_n, grip - LOOSEN_N_PER_S * STEP_S)
    if frame.status & (Status.SLIP_WARNING | Status.SLIDES):
        wanted = max(wanted, grip + SLIP_N_PER_S * STEP_S)
    return min(max(wanted, LEAST_N), MOST_N)


def command(grip: float) -> None:
    """Sends the grip to the gripper; this one has none."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", default="usb")
    parser.add_argument("--seconds", type=float, default=10.0)
    words = parser.parse_args()
    grip, highest, held, calls = LEAST_N, LEAST_N, 0, []
    with Finger(words.port) as finger:
        finger.set_fields(Fields.FORCE | Fields.SLIP)
        finger.set_rate(min(1000, finger.info().scan_hz))
        finger.latest()
        start = time.perf_counter()
        for step in range(int(words.seconds / STEP_S)):
            time.sleep(max(0.0, start + step * STEP_S - time.perf_counter()))
            asked = time.perf_counter()
            try:
                grip = next_grip(grip, finger.latest(MAX_AGE_S).frame)
            except StaleError:
                held += 1  # The finger is late: hold.
            calls.append(time.perf_counter() - asked)
            command(grip)
            highest = max(highest, grip)
        counts = finger.counts
    print(f"{len(calls)} steps, latest() within {np.quantile(calls, 0.99) * 1e3:.3f} ms in 99 %")
    print(f"grip up to {highest:.2f} N, at the end {grip:.2f} N; held {held} steps for late frames")
    print(f"{counts.frames} frames, {counts.lost} lost, {counts.skipped} skipped")


if __name__ == "__main__":
    try:
        main()
    except taxel.TaxelError as error:
        raise SystemExit(f"grip: {error}") from None

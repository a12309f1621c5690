"""Tests of a control loop: the newest frame at once, and every frame accounted for.

`TAXEL_ENDURE_S=600 pytest tests/test_control.py -s` runs each round for 60 s; the default is some seconds.
"""

import os
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from fingers import serve

from taxel import Fields, Finger, StaleError

SECONDS = 60.0 if os.environ.get("TAXEL_ENDURE_S") else 4.0


ROUNDS = 3
IDLE = 0.25
"""Processors that other programs may take on an idle machine."""


class Loop(NamedTuple):
    call_ms: float
    age_ms: float
    steps: int
    seen: int
    others: float
    """Processors that other programs took; infinite where that is unknown."""


def elsewhere_s() -> float:
    """Returns the processor seconds of all programs but this one and those that it started."""
    machine = Path("/proc/stat")
    if not machine.exists():
        return float("inf")
    # Fields user to steal, without idle and iowait; guest time is part of user.
    ticks = [int(field) for field in machine.read_text().split()[1:9]]
    own = 0
    for process in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = process.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue  # It has ended.
        if os.getpid() in (int(process.parent.name), int(fields[1])):
            own += int(fields[11]) + int(fields[12])
    return float(sum(ticks) - ticks[3] - ticks[4] - own) / float(os.sysconf("SC_CLK_TCK"))


def controlled(finger: Finger, hz: int) -> Loop:
    """Runs a loop of ``hz``; returns 99 % of the calls' durations and of the frames' ages."""
    calls, ages, seen = [], [], 0
    others_s = elsewhere_s()
    finger.stream(True)
    finger.latest(max_age_s=10)
    start = time.perf_counter()
    for step in range(int(SECONDS * hz)):
        time.sleep(max(0.0, start + step / hz - time.perf_counter()))
        before = time.perf_counter()
        latest = finger.latest(max_age_s=10)
        calls.append(time.perf_counter() - before)
        ages.append(latest.age_s)
        seen += latest.new
    finger.stream(False)
    # A loop on a busy machine takes longer; the finger goes on at its rate.
    elapsed = time.perf_counter() - start
    others = (elsewhere_s() - others_s) / elapsed if others_s < float("inf") else others_s
    counts = finger.counts
    assert counts.frames == counts.given + counts.skipped + counts.overflow + counts.waiting
    assert counts.lost == counts.overflow == counts.bad_packets == 0
    assert counts.frames == pytest.approx(elapsed * 1000, rel=0.02, abs=50)
    call, age = (float(np.quantile(values, 0.99)) * 1e3 for values in (calls, ages))
    return Loop(call, age, len(calls), seen, others)


def test_latest_is_2_ms_old_in_a_1_khz_loop(command: str):
    """The age is bounded by 2 ms in 99 of 100 steps on an idle machine, and loosely on any other.

    It has the delays of the virtual finger too, whose timer has steps of 1 ms. A round counts as idle if
    other programs took less than a quarter of a processor. The best of three rounds is judged.
    """
    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        finger.set_fields(Fields.ALL)
        assert finger.set_rate(1000) == 1000
        loops: list[Loop] = []
        while len(loops) < ROUNDS and not (loops and loops[-1].age_ms <= 2):
            loops.append(loop := controlled(finger, 1000))
            print(
                f"{SECONDS:.0f} s at 1 kHz: 99 % of the calls within {loop.call_ms:.3f} ms, of the ages "
                f"within {loop.age_ms:.2f} ms; {loop.seen} new frames in {loop.steps} steps; others took "
                f"{loop.others:.1f} processors"
            )
    assert min(loop.call_ms for loop in loops) <= 2
    assert min(loop.age_ms for loop in loops) <= 50
    assert max(loop.seen / loop.steps for loop in loops) >= 0.25
    idle = [loop for loop in loops if loop.others < IDLE]
    if idle:
        assert min(loop.age_ms for loop in idle) <= 2
        assert max(loop.seen / loop.steps for loop in idle) >= 0.5
    else:
        print("the machine had too much else to do to tell how old a frame is")


def test_slow_loop_gets_the_newest_frame_and_counts_the_rest(command: str):
    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        finger.set_rate(1000)
        skipped, times = 0, []
        for _ in range(10):
            latest = finger.latest()
            skipped += latest.skipped
            times.append(latest.frame.time_s)
            time.sleep(0.05)
        assert finger.counts.skipped == skipped > 100
        # As much device time has passed as the loop took: it is not behind.
        assert times[-1] - times[0] > 0.25


def test_host_time_of_a_frame_lies_before_its_reception(command: str):
    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        unknown, known = [], []
        for frame in finger.frames(seconds=2.5):
            host = finger.host_time(frame)
            if host is None:
                unknown.append(frame.time_s)
            else:
                known.append((time.monotonic() - host.monotonic_s, host.error_s))
                assert abs(time.time() - host.unix_s) < 1
        assert len(known) > 1000 and len(unknown) < 1500
        # A scan is a link delay old, within the stated error.
        assert all(late > -error for late, error in known)
        assert np.median([late for late, _ in known]) < 0.1


def test_stale_frame_is_an_error_in_a_loop(command: str):
    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        finger.set_rate(1000)
        finger.latest()
        finger.set_rate(1)
        time.sleep(0.3)
        with pytest.raises(StaleError, match="allowed are 0.1 s"):
            finger.latest()

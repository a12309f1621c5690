"""Tests of the frames' way to a program: order, age, loss and back-pressure."""

import time
import warnings

import pytest

from taxel import Force, Frame, LinkError, NoValue, StaleError, Status, StreamWarning
from taxel.clock import DeviceClock
from taxel.stream import QUEUE, Stream


def frame(seq: int, time_us: int | None = None) -> Frame:
    time_us = 1000 * seq if time_us is None else time_us
    return Frame(seq, time_us, Status(0), None, None, None, None, None, None, None, None)


def streaming(*seqs: int) -> Stream:
    stream = Stream("test")
    stream.start()
    for seq in seqs:
        stream.push(frame(seq), time.monotonic())
    return stream


def test_latest_is_the_newest_and_counts_what_it_skips():
    stream = streaming(1, 2, 3)
    latest = stream.latest(0.1, 0)
    assert (latest.frame.seq, latest.new, latest.skipped) == (3, True, 2)
    counts = stream.counts(0)
    assert (counts.frames, counts.given, counts.skipped, counts.waiting) == (3, 1, 2, 0)


def test_latest_tells_that_a_frame_is_not_new():
    stream = streaming(1)
    first, again = stream.latest(1, 0), stream.latest(1, 0)
    assert first.new and not again.new and again.frame is first.frame
    assert again.age_s >= first.age_s and stream.counts(0).given == 1


def test_latest_refuses_a_stale_frame():
    stream = Stream("test")
    stream.start()
    stream.push(frame(1), time.monotonic() - 0.3)
    with pytest.raises(StaleError, match=r"test: the newest frame is 0\.3\d\d s old, allowed are 0.1 s"):
        stream.latest(0.1, 0)
    assert stream.latest(1, 0).age_s == pytest.approx(0.3, abs=0.2)


def test_latest_raises_after_the_end_of_the_stream():
    stream = streaming(1)
    stream.end(LinkError("test: gone"))
    with pytest.raises(LinkError, match="gone"):
        stream.latest(10, 0)


def test_lost_frames_are_counted_and_said_once():
    stream = streaming(1, 2, 5, 6)
    with pytest.warns(StreamWarning, match="test: 2 frames were lost on the link"):
        assert stream.next(0).seq == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert [stream.next(0).seq for _ in range(3)] == [2, 5, 6]
    assert stream.counts(0).lost == 2


@pytest.mark.parametrize(
    ("seqs", "lost"),
    [
        ((7, 8, 11, 12, 14), 3),
        ((2**32 - 2, 2**32 - 1, 0, 1), 0),
        ((2**32 - 2, 2), 3),
        # Duplicates and late frames.
        ((5, 5, 6, 4, 7), 0),
        ((0, 2**32 - 1, 1), 0),
        # A finger that has restarted, forwards and back.
        ((7, 2_147_483_600, 2_147_483_602), 1),
        ((100_000, 0, 1, 3), 1),
        ((7, 110_000, 110_002), 1),
    ],
)
def test_impossible_jump_is_a_restart_and_counts_no_loss(seqs: tuple[int, ...], lost: int):
    assert streaming(*seqs).counts(0).lost == lost


def test_long_silence_explains_a_long_gap():
    stream = streaming()
    stream.push(frame(7), 100.0)
    stream.push(frame(3_600_008), 3700.0)
    assert stream.counts(0).lost == 3_600_000


def test_slow_program_is_told_that_it_is_behind():
    stream = streaming(*range(1500))
    with pytest.warns(StreamWarning, match=r"1\.5 s behind the finger, 1499 frames wait"):
        stream.next(0)


def test_full_queue_drops_its_oldest_frames_and_says_so():
    stream = streaming(*range(QUEUE + 3))
    with pytest.warns(StreamWarning) as said:
        assert stream.next(0).seq == 3
    assert any("too slow, 3 frames were dropped" in str(each.message) for each in said)
    counts = stream.counts(0)
    assert counts.overflow == 3 and counts.lost == 0
    assert counts.frames == counts.given + counts.skipped + counts.overflow + counts.waiting


def test_no_value_is_false_and_tells_its_reason():
    assert not NoValue.NO_CONTACT and not any(NoValue)
    with pytest.raises(TypeError, match="no value: no contact"):
        float(NoValue.NO_CONTACT)
    assert bool(Force(0.0, 0.0, 0.0))


def test_device_time_in_seconds_is_the_frames_own():
    assert frame(1, 1_250_000).time_s == 1.25


@pytest.mark.parametrize("ppm", [-80.0, 0.0, 80.0])
def test_host_time_is_within_its_stated_error(ppm: float):
    clock = DeviceClock()
    clock.echo(0.9e-3)
    clock.echo(0.5e-3)
    errors = []
    for i in range(30_000):
        true = i * 1e-3
        device = round(5e6 + true * 1e6 * (1 + ppm * 1e-6))
        noise = i * 2654435761 % 2**32 / 2**32
        delay = 2e-4 + 3e-3 * noise**4 + (0.02 if i % 97 == 0 else 0.0)
        clock.frame(device, 100 + true + delay)
        host = clock.host(device)
        assert (host is None) == (device < 6e6) or abs(device - 6e6) < 2000
        if host is not None:
            errors.append(abs(host.monotonic_s - 100 - true))
            assert errors[-1] <= host.error_s < 1e-2
    # The shortest delay is 0.2 ms, half the shortest round trip 0.25 ms.
    assert len(errors) > 28_000 and sorted(errors)[len(errors) // 2] < 0.15e-3


def test_restarted_device_begins_a_new_clock():
    clock = DeviceClock()
    clock.echo(1e-3)
    for i in range(3000):
        clock.frame(10_000_000 + i * 1000, i * 1e-3)
    assert clock.host(12_000_000) is not None
    clock.frame(5000, 4.0)
    assert clock.host(5000) is None

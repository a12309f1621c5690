"""Tests against Rust: a virtual finger of the `taxel` command, and its estimates of a trace."""

import json
import os
import subprocess
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fingers import CALIBRATION, FAST, ROOT, replayed, serve

import taxel
from taxel import Fields, Finger, LinkError, RefusedError
from taxel.transport import SerialTransport, TcpTransport


@pytest.fixture
def finger(command: str) -> Iterator[Finger]:
    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        yield finger


def test_stream_has_no_gap(finger: Finger):
    finger.set_fields(Fields.ESTIMATES)
    rate = finger.set_rate(500)
    frames = list(finger.frames(seconds=1))
    assert len(frames) == pytest.approx(rate, abs=1)
    assert {b.seq - a.seq for a, b in zip(frames, frames[1:], strict=False)} == {1}
    assert finger.counts[1:4] == (0, 0, 0)
    assert all(frame.codes is None and frame.force is not None for frame in frames)


def test_settings_are_active_and_reported(finger: Finger):
    finger.set_rate(250)
    finger.set_fields(Fields.FORCE | Fields.POINT)
    info = finger.info()
    assert (info.rate_millihertz, info.fields) == (250_000, Fields.FORCE | Fields.POINT)
    assert info.calibration is not None and info.scan_hz >= 250


def test_refusal_gives_its_reason_in_one_line(finger: Finger):
    with pytest.raises(RefusedError, match=r"out of range: it must be 1…\d+$") as refused:
        finger.set_rate(0)
    assert refused.value.refusal.details[0] == 1


def test_refused_number_is_told_with_name_and_range(finger: Finger):
    for call, name, numbers, expected in (
        (finger.set_rate, "rate", (-1, 70_000), r"1…\d+"),
        (finger.set_filter, "filter", (-1, 70_000), r"0…\d+"),
        (finger.self_test, "scans", (-1, 70_000), "2…4096"),
        (finger.take_bias, "scans", (-1, 70_000), "2…65535"),
    ):
        for number in numbers:
            with pytest.raises(RefusedError, match=f": {name}: out of range: it must be {expected}$"):
                call(number)


def test_calibration_reads_back_as_uploaded(finger: Finger):
    record = finger.download_calibration()
    assert len(record) > 100
    finger.upload_calibration(record)
    assert finger.download_calibration() == record
    damaged = record[:-1] + bytes([record[-1] ^ 1])
    with pytest.raises(RefusedError, match="not a calibration"):
        finger.upload_calibration(damaged)
    assert finger.download_calibration() == record


def test_requests_are_answered_while_frames_stream(finger: Finger):
    for i, _ in enumerate(finger.frames(seconds=0.5)):
        if i % 100 == 0:
            assert finger.info().streaming
    assert finger.counts.lost == 0


def test_self_test_has_the_channels_of_the_command(command: str):
    idle = f"sim:{ROOT}/host-tools/cli/tests/scenes/idle.toml"
    with serve(command, idle, "--tcp", "127.0.0.1:0", "--calibration", str(CALIBRATION)) as port:
        with Finger(port) as finger:
            test = finger.self_test(100)
            with pytest.raises(RefusedError, match="out of range: it must be 2…4096"):
                finger.self_test(1)
        judged = [command, "self-test", "--port", port, "--json"]
        said = subprocess.run(judged, capture_output=True, check=True)
    theirs = json.loads(said.stdout)
    ours = {f"lit_r{k // 4}c{k % 4}": channel for k, channel in enumerate(test.lit)}
    ours |= {f"dark_c{c}": channel for c, channel in enumerate(test.dark)}
    ours |= {f"bridge_s{s}_{'abcd'[m]}": test.bridges[s][m] for s in range(4) for m in range(4)}
    ours |= {"aux_vref": test.reference, "aux_temp": test.temperature}
    there = {name: channel for name, channel in ours.items() if channel is not None}
    assert there.keys() == theirs["channels"].keys() and len(there) >= 37
    for name, channel in there.items():
        assert channel.mean == pytest.approx(theirs["channels"][name]["mean"], abs=60), name
        assert 0.3 < channel.noise / theirs["channels"][name]["noise"] < 3, name
    assert (test.scans, test.full_scale, test.record_intact) == (100, theirs["full_scale"], True)


class Late(TcpTransport):
    """Connection whose bytes come in ``late_s`` seconds late, as to a program that is behind."""

    late_s = 0.0

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port)
        self.waiting: deque[tuple[float, bytes]] = deque()

    def read(self) -> bytes:
        if data := super().read():
            self.waiting.append((time.monotonic() + self.late_s, data))
        due = bool(self.waiting) and self.waiting[0][0] <= time.monotonic()
        return self.waiting.popleft()[1] if due else b""


def test_request_is_answered_behind_unread_frames(command: str):
    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port:
        host, _, number = port.removeprefix("tcp:").rpartition(":")
        link = Late(host, int(number))
        with Finger(port, transport=link) as finger:
            finger.stream(True)
            for step in range(30):
                link.late_s = step / 10
                time.sleep(0.1)
            # 3 s late, longer than all tries together.
            assert finger.info().streaming


def test_pulled_cable_raises_after_the_last_frame(command: str):
    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port:
        finger = Finger(port)
        stream = finger.frames()
        next(stream)
    with pytest.raises(LinkError, match="closed the link|reset by peer"):
        for _ in stream:
            pass
    finger.close()


@pytest.mark.parametrize(
    ("port", "says"),
    [
        ("/dev/no-such-finger", "there is no such device"),
        ("tcp:localhost", "not HOST:PORT"),
        ("tcp:127.0.0.1:1", "refused"),
    ],
)
def test_wrong_port_is_an_error_in_one_line(port: str, says: str):
    with pytest.raises(LinkError, match=says) as error:
        Finger(port)
    assert "\n" not in str(error.value) and str(error.value).startswith(port)


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals are Unix's")
def test_uart_opens_at_the_protocols_speed():
    import termios

    ours, theirs = os.openpty()
    port = SerialTransport(os.ttyname(theirs))
    _, _, control, _, speed_in, speed_out, _ = termios.tcgetattr(theirs)
    port.close()
    os.close(ours)
    os.close(theirs)
    assert speed_in == speed_out == termios.B1000000
    eight_n_one = termios.CS8
    assert control & (termios.CSIZE | termios.PARENB | termios.CSTOPB) == eight_n_one
    assert "**1 000 000 baud, 8N1**" in (ROOT / "docs/protocol.md").read_text()


@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals are Unix's")
def test_serial_device_works_like_tcp(command: str):
    with serve(command, "sim:tour") as port, Finger(port) as finger:
        finger.set_rate(1000)
        assert len(list(finger.frames(seconds=1))) == pytest.approx(1000, abs=2)
        assert finger.counts.lost == 0


def test_values_match_rust(command: str, tmp_path: Path):
    """Compares every field of a trace bit for bit: `taxel replay`, and TCP through this package."""
    trace, expected = replayed(command, "tour", tmp_path)
    served = serve(command, f"file:{trace}", "--tcp", "127.0.0.1:0", "--calibration", str(CALIBRATION))
    with served as port, Finger(port) as finger:
        finger.set_fields(Fields.ALL)
        finger.set_rate(finger.info().scan_hz)
        frames = list(finger.frames(seconds=4))
        assert finger.counts.lost == 0
    table = taxel.columns(frames, Fields.ALL)
    assert len(frames) > 1000 and np.nanmax(table["fz_n"]) > 0.1
    assert table.keys() == next(iter(expected.values())).keys()
    rows = [expected[int(t)] for t in table["t_us"]]
    for name in table.keys() - {"t_us", "seq"}:
        theirs = np.array([np.float32(row[name]) if row[name] else np.nan for row in rows])
        np.testing.assert_array_equal(table[name].astype(np.float32), theirs, err_msg=name)


def test_4_khz_are_sustained(command: str, tmp_path: Path):
    scene = tmp_path / "fast.toml"
    scene.write_text(FAST)
    with serve(command, f"sim:{scene}", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        assert finger.set_rate(4000) == 4000
        finger.set_fields(Fields.ALL)
        # The finger's clock does not wait for a slow reader, which would lose frames.
        times = [frame.time_us for frame in finger.frames(seconds=10)]
        assert len(times) == pytest.approx(40_000, abs=4)
        assert times[-1] - times[0] == pytest.approx(10e6, abs=1000)
        assert finger.counts.lost == finger.counts.overflow == finger.counts.bad_packets == 0

"""Tests of the golden bytes in docs/protocol.md and tests/core/wire_golden.rs."""

import pytest

from taxel import (
    Contact,
    Fields,
    Force,
    Frame,
    MalformedError,
    NoValue,
    Point,
    PointMethod,
    Slip,
    Status,
    Uncertainty,
    read_frames,
)
from taxel.commands import Command, request
from taxel.messages import Bridge
from taxel.packets import MAX_PACKET, Deframer, pack
from taxel.replies import Done, Rate, Refusal, Reply, Version, decode

FRAME = "02 ac 02 c0 84 3d 81 80 10 00 00 00 00 00 00 00 00"


def message(text: str) -> bytes:
    return bytes.fromhex(text)


def test_version_query_is_frozen():
    assert pack(request(1, Command.VERSION)) == message("02 01 05 be 23 c2 58 00")
    assert decode(message("00 01 01 00 01 00")) == Version(1, 1, (0, 1, 0))


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (Command.INFO, "07 01"),
        (Command.stream(True), "07 02 01"),
        (Command.set_rate(1000), "07 03 e8 07"),
        (Command.set_fields(Fields.ESTIMATES), "07 04 3c"),
        (Command.set_point_method(PointMethod.ARG_MIN), "07 05 01"),
        (Command.set_point_method(PointMethod.MODEL), "07 05 02"),
        (Command.set_filter(150), "07 13 96 01"),
        (Command.hold_row(None), "07 14 00"),
        (Command.hold_row(3), "07 14 01 03"),
        (Command.take_bias(500), "07 06 f4 03"),
        (Command.READ_BIAS, "07 07"),
        (Command.CLEAR_BIAS, "07 08"),
        (Command.calibration_begin(1500), "07 09 dc 0b"),
        (Command.calibration_chunk(128, b"\xaa\xbb"), "07 0a 80 01 02 aa bb"),
        (Command.CALIBRATION_COMMIT, "07 0b"),
        (Command.calibration_read(0), "07 0c 00"),
        (Command.SAVE_SETTINGS, "07 0d"),
        (Command.SAVE_BIAS, "07 0e"),
    ],
)
def test_requests_have_their_bytes(command: bytes, expected: str):
    assert request(7, command) == message(expected)


@pytest.mark.parametrize(
    ("reply", "result"),
    [
        ("01 07 00 00", Done()),
        ("01 07 00 02 c0 84 3d", Rate(1_000_000)),
        ("01 07 01 00 01 a0 1f", Refusal("out of range", (1, 4000))),
        ("01 07 01 01", Refusal("the finger is not still")),
        ("01 07 01 04 01", Refusal("the record is not a calibration", (1,))),
        ("01 07 01 04 04 10 02", Refusal("the record is not a calibration", (4, 16, 2))),
        ("01 07 01 07", Refusal("the flash failed; what was stored before stays")),
    ],
)
def test_replies_are_read(reply: str, result: object):
    assert decode(message(reply)) == Reply(7, result)


def test_frame_without_fields_is_read():
    frame = decode(message(FRAME))
    assert frame == Frame(300, 1_000_000, Status.CONTACT | Status.RAN_NET, *[None] * 8)
    assert frame.in_contact


def test_estimates_and_reasons_are_read():
    frame = decode(
        message(
            "02 ac 02 c0 84 3d 81 80 10 00 00"
            "01 00 00 00 00 3f 00 00 00 00 bf 00 00 00 80 3f 01 06 01 06 01 06 01 00 01 00 01 00"
            "01 03 01 03 01 03"
            "01 01 07 00 00 00 00 00 00 00 00 80 3e"
            "01 00 00 00 a0 3f 00 00 00 c0"
            "01 00 00 00 80 3e 00 00 00 3f 00 00 00 40"
            "01 00 00 00 00 c0"
            "01 00 00 00 a0 3f 00 00 00 c0 00 00 80 3e 00 00 00 bf 00 00 80 3f 00 00 00 3f"
        )
    )
    assert frame.sensors[0] == Force(0.5, -0.5, 1.0)
    assert frame.sensors[3] == Force(*[NoValue.DEAD_CHANNEL] * 3)
    assert frame.force == Force(NoValue.NOT_ESTIMATED, 0.0, 0.25)
    assert frame.point == Point(1.25, -2.0)
    assert frame.slip == Slip(0.25, 0.5, 2.0)
    assert frame.torsion_nmm == -2.0
    assert frame.contacts == (Contact(Point(1.25, -2.0), 0.25), Contact(Point(-0.5, 1.0), 0.5))


def test_frame_may_end_with_its_uncertainty():
    sure = "01 00 01 07 00 00 00 00 3f 00 00 00 80 3e 00 00 00 00 3f 00 00 80 3e 00 00 00 80 3f"
    force = Force(NoValue.NOT_ESTIMATED, 0.5, 0.25)
    assert decode(message(FRAME + sure)).uncertainty == Uncertainty(force, Point(0.5, 0.25), 1.0)
    assert decode(message(FRAME + "01 01 01")).uncertainty is NoValue.NO_CONTACT
    assert decode(message(FRAME)).uncertainty is None


def test_codes_and_signals_are_read():
    frame = decode(
        message(
            "02 ac 02 c0 84 3d 81 80 10 01 ff 0f 00 00 00 00 01 01 00 02 00 03 00 04 00 01 34 12 00"
            f"01 01 {'00 00 00 bf' * 16} 01 {'00 00 80 3e' * 3} 00 00 00 81 02 00 08 00 00 00 00 00 00"
        )
    )
    assert frame.codes.full_scale == 4095
    assert frame.codes.bridges == (None, None, None, Bridge(1, 2, 3, 4))
    assert (frame.codes.reference, frame.codes.temperature) == (0x1234, None)
    assert frame.signals.taxels == (-0.5,) * 16
    assert frame.signals.bridges == ((0.25,) * 3, None, None, None)
    assert (frame.signals.saturated, frame.signals.bridge_faults) == (0x101, 8)


def test_no_value_is_no_number():
    with pytest.raises(TypeError):
        NoValue.ABSENT + 1


@pytest.mark.parametrize(
    "text", ["", "03", "02 ac", FRAME[:-3], FRAME + " 00", FRAME + " 01 00", "01 07 02", "01 07 01 00 80"]
)
def test_invalid_message_is_an_error(text: str):
    with pytest.raises(MalformedError):
        decode(message(text))


def test_pieces_of_any_length_give_the_same_frames():
    stream = pack(message(FRAME)) * 5
    for length in range(1, len(stream)):
        pieces = [stream[at : at + length] for at in range(0, len(stream), length)]
        assert [frame.seq for frame in read_frames(pieces)] == [300] * 5


def test_stream_joined_midway_counts_no_bad_packet():
    deframer = Deframer()
    assert list(deframer.push(pack(message(FRAME))[3:] + pack(message(FRAME)))) == [message(FRAME)]
    assert deframer.bad_packets == 0


def test_damaged_and_overlong_packets_are_counted():
    deframer, good = Deframer(), pack(message(FRAME))
    damaged = bytes([good[0], good[1] ^ 1]) + good[2:]
    stream = good + damaged + b"\0\0" + b"\x55" * (3 * MAX_PACKET) + b"\0" + good
    assert list(deframer.push(stream)) == [message(FRAME)] * 2
    assert deframer.bad_packets == 2
    deframer = Deframer()
    assert [m for byte in stream for m in deframer.push(bytes([byte]))] == [message(FRAME)] * 2
    assert deframer.bad_packets == 2

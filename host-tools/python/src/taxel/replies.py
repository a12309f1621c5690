"""Replies: docs/protocol.md, section "Finger → host"."""

from __future__ import annotations

import struct
from typing import NamedTuple, TypeAlias

from . import _postcard as read
from .errors import MalformedError
from .messages import _SIXTEEN_F32, _THREE_F32, Fields, Frame, PointMethod, Status, _frame

PROTOCOL = 2
"""Protocol version of this package."""

_THREE_U8 = read.array("<3B")


class Version(NamedTuple):
    """Reply to the version query."""

    tag: int
    protocol: int
    firmware: tuple[int, int, int]


class CalibrationId(NamedTuple):
    """Identity of the active calibration."""

    serial: str
    date: int
    crc: int


class Info(NamedTuple):
    """Identity, settings and counters of a finger; costs are ticks of one scan, ``tick_hz`` per second."""

    board: str
    serial: str
    build: str
    scan_hz: int
    full_scale: int
    tick_hz: int
    rate_millihertz: int
    fields: Fields
    streaming: bool
    point_method: PointMethod
    biased: bool
    calibration: CalibrationId | None
    scans: int
    frames: int
    lost: int
    overruns: int
    bad_packets: int
    lost_replies: int
    cost_last: int
    cost_worst: int
    estimators: Status
    filter_hz: int


class Rate(NamedTuple):
    """Active frame rate."""

    millihertz: int


class TaxelBias(NamedTuple):
    """Bias of sixteen taxels, as shares of full scale."""

    level: tuple[float, ...]
    noise: float


class BridgeBias(NamedTuple):
    """Bias of a sensor's three signals, as shares of full scale."""

    level: tuple[float, ...]
    noise: float


class Bias(NamedTuple):
    """Reading of the unloaded finger, taken on command or the calibration's own."""

    taxels: TaxelBias | None
    bridges: tuple[BridgeBias | None, ...]
    on_command: bool
    in_contact: bool


class CalibrationChunk(NamedTuple):
    """Bytes of the active calibration record."""

    offset: int
    data: bytes


class Channel(NamedTuple):
    """Mean and standard deviation of a channel's codes."""

    mean: float
    noise: float


class SelfTest(NamedTuple):
    """Codes of every channel, a number of scans long; a channel that the board lacks is ``None``."""

    scans: int
    full_scale: int
    lit: tuple[Channel | None, ...]
    """Sixteen by row."""
    dark: tuple[Channel | None, ...]
    bridges: tuple[tuple[Channel | None, ...], ...]
    """Four midpoints of each sensor."""
    reference: Channel | None
    temperature: Channel | None
    record_intact: bool | None
    """False if a stored calibration is damaged, ``None`` without one."""


class Done(NamedTuple):
    """Reply to a request that was carried out."""


class Refusal(NamedTuple):
    """Rejection of a request: the reason in words, with its numbers."""

    reason: str
    details: tuple[int, ...] = ()

    def __str__(self) -> str:
        if self.reason == "out of range":
            return "out of range: it must be {}…{}".format(*self.details)
        return " ".join([self.reason, *map(str, self.details)])


Response: TypeAlias = Done | Info | Rate | Bias | CalibrationChunk | SelfTest


class Reply(NamedTuple):
    """Reply to any request but the version query."""

    tag: int
    result: Response | Refusal


Message: TypeAlias = Version | Reply | Frame


def _version(data: bytes, at: int) -> tuple[Version, int]:
    tag, at = read.u8(data, at)
    protocol, at = read.varint(data, at)
    firmware, at = _THREE_U8(data, at)
    return Version(tag, protocol, (firmware[0], firmware[1], firmware[2])), at


def _calibration_id(data: bytes, at: int) -> tuple[CalibrationId, int]:
    serial, at = read.text(data, at)
    date, at = read.varint(data, at)
    crc, at = read.varint(data, at)
    return CalibrationId(serial, date, crc), at


_CALIBRATION_ID = read.option(_calibration_id)


def _info(data: bytes, at: int) -> tuple[Info, int]:
    board, at = read.text(data, at)
    serial, at = read.text(data, at)
    build, at = read.text(data, at)
    scan_hz, at = read.varint(data, at)
    full_scale, at = read.code(data, at)
    tick_hz, at = read.varint(data, at)
    rate, at = read.varint(data, at)
    fields, at = read.varint(data, at)
    streaming, at = read.boolean(data, at)
    method, at = read.variant(tuple(PointMethod), data, at)
    biased, at = read.boolean(data, at)
    calibration, at = _CALIBRATION_ID(data, at)
    counts, at = read.times(8, read.varint)(data, at)
    estimators, at = read.varint(data, at)
    filter_hz, at = read.varint(data, at)
    known = (board, serial, build, scan_hz, full_scale, tick_hz, rate, Fields(fields), streaming)
    scans, frames, lost, overruns, bad_packets, lost_replies, cost_last, cost_worst = counts
    counters = (scans, frames, lost, overruns, bad_packets, lost_replies, cost_last, cost_worst)
    held = Status(estimators)
    return Info(*known, method, biased, calibration, *counters, held, filter_hz), at


def _taxel_bias(data: bytes, at: int) -> tuple[TaxelBias, int]:
    level, at = _SIXTEEN_F32(data, at)
    noise, at = read.f32(data, at)
    return TaxelBias(level, noise), at


def _bridge_bias(data: bytes, at: int) -> tuple[BridgeBias, int]:
    level, at = _THREE_F32(data, at)
    noise, at = read.f32(data, at)
    return BridgeBias(level, noise), at


_TAXEL_BIAS = read.option(_taxel_bias)
_BRIDGE_BIASES = read.times(4, read.option(_bridge_bias))


def _bias(data: bytes, at: int) -> tuple[Bias, int]:
    taxels, at = _TAXEL_BIAS(data, at)
    bridges, at = _BRIDGE_BIASES(data, at)
    on_command, at = read.boolean(data, at)
    in_contact, at = read.boolean(data, at)
    return Bias(taxels, bridges, on_command, in_contact), at


def _rate(data: bytes, at: int) -> tuple[Rate, int]:
    millihertz, at = read.varint(data, at)
    return Rate(millihertz), at


def _chunk(data: bytes, at: int) -> tuple[CalibrationChunk, int]:
    offset, at = read.varint(data, at)
    record, at = read.blob(data, at)
    return CalibrationChunk(offset, record), at


def _done(_: bytes, at: int) -> tuple[Done, int]:
    return Done(), at


_TWO_F32 = read.array("<2f")


def _channel(data: bytes, at: int) -> tuple[Channel, int]:
    values, at = _TWO_F32(data, at)
    return Channel(*values), at


_CHANNEL = read.option(_channel)
_FOUR_CHANNELS = read.times(4, _CHANNEL)
_INTACT = read.option(read.boolean)


def _self_test(data: bytes, at: int) -> tuple[SelfTest, int]:
    scans, at = read.varint(data, at)
    full_scale, at = read.code(data, at)
    lit, at = read.times(16, _CHANNEL)(data, at)
    dark, at = _FOUR_CHANNELS(data, at)
    bridges, at = read.times(4, _FOUR_CHANNELS)(data, at)
    reference, at = _CHANNEL(data, at)
    temperature, at = _CHANNEL(data, at)
    intact, at = _INTACT(data, at)
    return SelfTest(scans, full_scale, lit, dark, bridges, reference, temperature, intact), at


def _health(data: bytes, at: int) -> tuple[Response, int]:
    raise ValueError("health is not read by this package")


#: Reason of a request that the finger takes later: ask again.
BUSY = "busy with a bias, a self-test or a save; ask again in a second"

_RESPONSES = (_done, _info, _rate, _bias, _chunk, _health, _self_test)
_REFUSALS = (
    "out of range",
    "the finger is not still",
    BUSY,
    "a chunk out of order",
    "the record is not a calibration",
    "there is no calibration",
    "a taxel is clipped",
    "the flash failed; what was stored before stays",
    "this board has no such thing",
    "the scan cannot be so",
)


def _refusal(data: bytes, at: int) -> tuple[Refusal, int]:
    number, at = read.varint(data, at)
    reason = _REFUSALS[number] if number < len(_REFUSALS) else f"refusal {number}"
    if number == 0:
        limits, at = read.times(2, read.varint)(data, at)
        return Refusal(reason, limits), at
    # The rest of a refusal, if any, holds its numbers.
    details = []
    while at < len(data):
        detail, at = read.varint(data, at)
        details.append(detail)
    return Refusal(reason, tuple(details)), at


def _reply(data: bytes, at: int) -> tuple[Reply, int]:
    tag, at = read.u8(data, at)
    refused, at = read.boolean(data, at)
    if refused:
        refusal, at = _refusal(data, at)
        return Reply(tag, refusal), at
    response, at = read.variant(_RESPONSES, data, at)
    result, at = response(data, at)
    return Reply(tag, result), at


_MESSAGES = (_version, _reply, _frame)


def decode(message: bytes) -> Message:
    """Decodes a message without its COBS and CRC.

    Raises :class:`MalformedError` for an invalid, short or long message.
    """
    try:
        reader, at = read.variant(_MESSAGES, message, 0)
        decoded: Message
        decoded, at = reader(message, at)
    except (IndexError, ValueError, struct.error) as error:
        raise MalformedError(f"{message.hex(' ')} is no message of protocol {PROTOCOL}: {error}") from error
    if at != len(message):
        raise MalformedError(f"{message.hex(' ')} has {len(message) - at} bytes too many")
    return decoded

"""Messages: docs/protocol.md, sections "Host → finger", "Finger → host" and "A frame"."""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import Enum, IntFlag
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from . import _postcard as read
from ._postcard import write_varint
from .errors import MalformedError

T = TypeVar("T")

PROTOCOL = 2
"""Protocol version of this package."""

CHUNK = 128
"""Largest number of bytes of a calibration record in one message."""


# schema: masks (from src/frame/schema.rs by `cargo xtask protocol`)
class Status(IntFlag):
    """State of a frame and the estimators that ran for it. Bits that this package does not know are
    kept."""

    CONTACT = 1 << 0
    UNCALIBRATED = 1 << 1
    SATURATED = 1 << 2
    DEAD_TAXEL = 1 << 3
    BRIDGE_FAULT = 1 << 4
    OUT_OF_RANGE = 1 << 5
    OVERRUN = 1 << 6
    BIASED = 1 << 7
    STUCK_CHANNEL = 1 << 8
    NOT_SINGLE = 1 << 9
    DISAGREE = 1 << 10
    SLIP_WARNING = 1 << 11
    SLIDES = 1 << 12
    TEMPERATURE = 1 << 13
    NOISY = 1 << 14
    ROW_HELD = 1 << 15
    RAN_ARG_MIN = 1 << 16
    RAN_CENTROID = 1 << 17
    RAN_NET = 1 << 18
    RAN_SENSORS = 1 << 19
    RAN_MODEL = 1 << 20
    RAN_SHEAR = 1 << 21
    RAN_PAIR = 1 << 22
    RAN_ARRAY = 1 << 23
    RAN_SLIP = 1 << 24
    RAN_QUANTISED = 1 << 25
    RAN_WARMTH = 1 << 26


class Fields(IntFlag):
    """Selection of fields: those that a frame carries."""

    CODES = 1 << 0
    SIGNALS = 1 << 1
    SENSORS = 1 << 2
    FORCE = 1 << 3
    POINT = 1 << 4
    SLIP = 1 << 5
    TORSION = 1 << 6
    CONTACTS = 1 << 7
    UNCERTAINTY = 1 << 8
    ESTIMATES = SENSORS | FORCE | POINT | SLIP
    ALL = (1 << 9) - 1


# schema: end


class NoValue(Enum):
    """Reason for a missing value: false, and no number, so that no program computes with it by mistake."""

    UNCALIBRATED = 0
    NO_CONTACT = 1
    SATURATED = 2
    DEAD_CHANNEL = 3
    OUT_OF_TRAINED_RANGE = 4
    ILL_CONDITIONED = 5
    ABSENT = 6
    NOT_ESTIMATED = 7

    def __bool__(self) -> bool:
        return False

    if not TYPE_CHECKING:  # A type checker rejects the conversion itself.

        def __float__(self) -> float:
            raise TypeError(f"no value: {self.name.lower().replace('_', ' ')}")


class PointMethod(Enum):
    """Method for the contact point."""

    CENTROID = 0
    ARG_MIN = 1
    MODEL = 2


class Bridge(NamedTuple):
    """Midpoints of a sensor's four half bridges, as ADC codes."""

    a: int
    b: int
    c: int
    d: int


class Codes(NamedTuple):
    """ADC codes: ``lit`` has sixteen codes by row, ``dark`` one for each column."""

    full_scale: int
    lit: tuple[int, ...] | None
    dark: tuple[int, ...] | None
    bridges: tuple[Bridge | None, ...]
    reference: int | None
    temperature: int | None


class Signals(NamedTuple):
    """Conditioned signals: sixteen taxels, negative where the facet came nearer, and u − b of four sensors.

    A bit for each taxel or sensor flags its faults.
    """

    taxels: tuple[float, ...] | None
    bridges: tuple[tuple[float, ...] | None, ...]
    saturated: int
    dead: int
    bridge_faults: int


# schema: values
class Force(NamedTuple):
    """In newtons; z is the normal force."""

    x: float | NoValue
    y: float | NoValue
    z: float | NoValue


class Point(NamedTuple):
    """Contact position, in millimetres from the middle of the pad."""

    x_mm: float
    y_mm: float


class Slip(NamedTuple):
    """``margin`` is what is left of the friction, 1 unloaded and 0 at the limit; ``grip_n`` the normal
    force that would leave a third of it."""

    margin: float
    friction: float
    grip_n: float


class Contact(NamedTuple):
    """One of two contacts."""

    point: Point
    normal_n: float


class Uncertainty(NamedTuple):
    """Standard deviations of force and point, in newtons and millimetres; ``misfit`` is the residual of
    the skin model, 1 as in calibration."""

    force: Force
    point: Point | NoValue
    misfit: float | NoValue


# schema: end


class Frame(NamedTuple):
    """One frame of the stream; a field that was not requested is ``None``."""

    seq: int
    time_us: int
    status: Status
    # schema: frame
    codes: Codes | None
    signals: Signals | None
    sensors: tuple[Force, ...] | None
    force: Force | None
    point: Point | NoValue | None
    slip: Slip | NoValue | None
    torsion_nmm: float | NoValue | None
    contacts: tuple[Contact, Contact] | NoValue | None
    uncertainty: Uncertainty | NoValue | None = None
    # schema: end

    @property
    def in_contact(self) -> bool:
        """True while the contact gate reports contact."""
        return bool(self.status & 1)

    @property
    def time_s(self) -> float:
        """Device time in seconds."""
        return self.time_us * 1e-6


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


Response: TypeAlias = Done | Info | Rate | Bias | CalibrationChunk


class Reply(NamedTuple):
    """Reply to any request but the version query."""

    tag: int
    result: Response | Refusal


Message: TypeAlias = Version | Reply | Frame

_NO_VALUES = tuple(NoValue)
_SIXTEEN_F32 = read.array("<16f")
_THREE_F32 = read.array("<3f")
_THREE_U8 = read.array("<3B")


def _variant(names: tuple[Any, ...], data: bytes, at: int) -> tuple[Any, int]:
    number, at = read.varint(data, at)
    if number >= len(names):
        raise ValueError(f"variant {number} of {len(names)}")
    return names[number], at


def _number(data: bytes, at: int) -> tuple[float | NoValue, int]:
    failed, at = read.boolean(data, at)
    return _variant(_NO_VALUES, data, at) if failed else read.f32(data, at)


def _measured(reader: Callable[[bytes, int], tuple[Any, int]]) -> Callable[[bytes, int], tuple[Any, int]]:
    def value(data: bytes, at: int) -> tuple[Any, int]:
        failed, at = read.boolean(data, at)
        return _variant(_NO_VALUES, data, at) if failed else reader(data, at)

    return value


def _pair(reader: Callable[[bytes, int], tuple[T, int]]) -> Callable[[bytes, int], tuple[tuple[T, T], int]]:
    def pair(data: bytes, at: int) -> tuple[tuple[T, T], int]:
        one, at = reader(data, at)
        other, at = reader(data, at)
        return (one, other), at

    return pair


_TAXEL_CODES = read.option(read.array("<20H"))
_BRIDGE_CODES = read.times(4, read.option(read.array("<4H")))
_CODE = read.option(read.code)


def _codes(data: bytes, at: int) -> tuple[Codes, int]:
    full_scale, at = read.code(data, at)
    taxels, at = _TAXEL_CODES(data, at)
    bridges, at = _BRIDGE_CODES(data, at)
    reference, at = _CODE(data, at)
    temperature, at = _CODE(data, at)
    lit, dark = (taxels[:16], taxels[16:]) if taxels else (None, None)
    named = tuple(None if bridge is None else Bridge(*bridge) for bridge in bridges)
    return Codes(full_scale, lit, dark, named, reference, temperature), at


_TAXEL_SIGNALS = read.option(_SIXTEEN_F32)
_BRIDGE_SIGNALS = read.times(4, read.option(_THREE_F32))


def _signals(data: bytes, at: int) -> tuple[Signals, int]:
    taxels, at = _TAXEL_SIGNALS(data, at)
    bridges, at = _BRIDGE_SIGNALS(data, at)
    saturated, at = read.varint(data, at)
    dead, at = read.varint(data, at)
    faults, at = read.u8(data, at)
    return Signals(taxels, bridges, saturated, dead, faults), at


def _tail(reader: Callable[[bytes, int], tuple[T, int]], data: bytes, at: int) -> tuple[T | None, int]:
    """Reads an optional field at the end of a frame; before a later field, a missing one is marked."""
    if at == len(data):
        return None, at
    present, at = read.boolean(data, at)
    if present:
        return reader(data, at)
    if at == len(data):
        raise ValueError("a frame that ends with a field that it does not have")
    return None, at


# schema: readers
def _force(data: bytes, at: int) -> tuple[Force, int]:
    x, at = _number(data, at)
    y, at = _number(data, at)
    z, at = _number(data, at)
    return Force(x, y, z), at


_POINT_F32 = read.array("<2f")


def _point(data: bytes, at: int) -> tuple[Point, int]:
    values, at = _POINT_F32(data, at)
    return Point(*values), at


_SLIP_F32 = read.array("<3f")


def _slip(data: bytes, at: int) -> tuple[Slip, int]:
    values, at = _SLIP_F32(data, at)
    return Slip(*values), at


def _contact(data: bytes, at: int) -> tuple[Contact, int]:
    point, at = _point(data, at)
    normal_n, at = read.f32(data, at)
    return Contact(point, normal_n), at


def _uncertainty(data: bytes, at: int) -> tuple[Uncertainty, int]:
    force, at = _force(data, at)
    point, at = _measured(_point)(data, at)
    misfit, at = _number(data, at)
    return Uncertainty(force, point, misfit), at


_CODES_FIELD = read.option(_codes)
_SIGNALS_FIELD = read.option(_signals)
_SENSORS_FIELD = read.option(read.times(4, _force))
_FORCE_FIELD = read.option(_force)
_POINT_FIELD = read.option(_measured(_point))
_SLIP_FIELD = read.option(_measured(_slip))
_TORSION_FIELD = read.option(_number)
_CONTACTS_FIELD = read.option(_measured(_pair(_contact)))
_UNCERTAINTY_FIELD = _measured(_uncertainty)


def _frame(data: bytes, at: int) -> tuple[Frame, int]:
    seq, at = read.varint(data, at)
    time, at = read.varint(data, at)
    status, at = read.varint(data, at)
    codes, at = _CODES_FIELD(data, at)
    signals, at = _SIGNALS_FIELD(data, at)
    sensors, at = _SENSORS_FIELD(data, at)
    force, at = _FORCE_FIELD(data, at)
    point, at = _POINT_FIELD(data, at)
    slip, at = _SLIP_FIELD(data, at)
    torsion, at = _TORSION_FIELD(data, at)
    contacts, at = _CONTACTS_FIELD(data, at)
    uncertainty, at = _tail(_UNCERTAINTY_FIELD, data, at)
    return (
        Frame(
            seq,
            time,
            Status(status),
            codes,
            signals,
            sensors,
            force,
            point,
            slip,
            torsion,
            contacts,
            uncertainty,
        ),
        at,
    )


# schema: end


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
    method, at = _variant(tuple(PointMethod), data, at)
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


_RESPONSES = (_done, _info, _rate, _bias, _chunk)
_REFUSALS = (
    "out of range",
    "the finger is not still",
    "another bias is being taken",
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
    response, at = _variant(_RESPONSES, data, at)
    result, at = response(data, at)
    return Reply(tag, result), at


_MESSAGES = (_version, _reply, _frame)


def decode(message: bytes) -> Message:
    """Decodes a message without its COBS and CRC.

    Raises :class:`MalformedError` for an invalid, short or long message.
    """
    try:
        reader, at = _variant(_MESSAGES, message, 0)
        decoded: Message
        decoded, at = reader(message, at)
    except (IndexError, ValueError, struct.error) as error:
        raise MalformedError(f"{message.hex(' ')} is no message of protocol {PROTOCOL}: {error}") from error
    if at != len(message):
        raise MalformedError(f"{message.hex(' ')} has {len(message) - at} bytes too many")
    return decoded


class Command:
    """Requests as bytes, without their tag."""

    VERSION = bytes([0])
    INFO = bytes([1])
    READ_BIAS = bytes([7])
    CLEAR_BIAS = bytes([8])
    CALIBRATION_COMMIT = bytes([11])
    SAVE_SETTINGS = bytes([13])
    SAVE_BIAS = bytes([14])

    @staticmethod
    def stream(on: bool) -> bytes:
        return bytes([2, on])

    @staticmethod
    def set_rate(hz: int) -> bytes:
        return bytes([3]) + _u16(hz)

    @staticmethod
    def set_fields(fields: Fields) -> bytes:
        return bytes([4]) + _u16(int(fields))

    @staticmethod
    def set_point_method(method: PointMethod) -> bytes:
        return bytes([5, method.value])

    @staticmethod
    def take_bias(scans: int) -> bytes:
        return bytes([6]) + _u16(scans)

    @staticmethod
    def calibration_begin(length: int) -> bytes:
        return bytes([9]) + _u16(length)

    @staticmethod
    def calibration_chunk(offset: int, data: bytes) -> bytes:
        return bytes([10]) + _u16(offset) + write_varint(len(data)) + data

    @staticmethod
    def calibration_read(offset: int) -> bytes:
        return bytes([12]) + _u16(offset)

    @staticmethod
    def set_filter(hz: int) -> bytes:
        return bytes([19]) + _u16(hz)

    @staticmethod
    def hold_row(row: int | None) -> bytes:
        return bytes([20, 0]) if row is None else bytes([20, 1, row])


def request(tag: int, command: bytes) -> bytes:
    """Returns the message that requests ``command``; the reply carries the same ``tag``."""
    return bytes([tag]) + command


def _u16(value: int) -> bytes:
    if not 0 <= value <= 0xFFFF:
        raise ValueError(f"{value} does not fit: expected 0…65535")
    return write_varint(value)

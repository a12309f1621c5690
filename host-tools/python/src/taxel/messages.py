"""Frames: docs/protocol.md, section "A frame". Replies are in :mod:`taxel.replies`."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, IntFlag
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from . import _postcard as read

T = TypeVar("T")


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
    RAN_LAG = 1 << 27
    RAN_DRIFT = 1 << 28


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


_NO_VALUES = tuple(NoValue)
_SIXTEEN_F32 = read.array("<16f")
_THREE_F32 = read.array("<3f")


def _number(data: bytes, at: int) -> tuple[float | NoValue, int]:
    failed, at = read.boolean(data, at)
    return read.variant(_NO_VALUES, data, at) if failed else read.f32(data, at)


def _measured(reader: Callable[[bytes, int], tuple[Any, int]]) -> Callable[[bytes, int], tuple[Any, int]]:
    def value(data: bytes, at: int) -> tuple[Any, int]:
        failed, at = read.boolean(data, at)
        return read.variant(_NO_VALUES, data, at) if failed else reader(data, at)

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

"""Requests: docs/protocol.md, section "Host → finger"."""

from __future__ import annotations

from ._postcard import write_varint
from .messages import Fields, PointMethod

CHUNK = 128
"""Largest number of bytes of a calibration record in one message."""


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
        return bytes([3]) + _checked(hz)

    @staticmethod
    def set_fields(fields: Fields) -> bytes:
        return bytes([4]) + _u16(int(fields))

    @staticmethod
    def set_point_method(method: PointMethod) -> bytes:
        return bytes([5, method.value])

    @staticmethod
    def take_bias(scans: int) -> bytes:
        return bytes([6]) + _checked(scans, refused=0)

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
    def self_test(scans: int) -> bytes:
        return bytes([16]) + _checked(scans)

    @staticmethod
    def set_filter(hz: int) -> bytes:
        return bytes([19]) + _checked(hz)

    @staticmethod
    def hold_row(row: int | None) -> bytes:
        return bytes([20, 0]) if row is None else bytes([20, 1, row])


def request(tag: int, command: bytes) -> bytes:
    """Returns the message that requests ``command``; the reply carries the same ``tag``."""
    return bytes([tag]) + command


def _checked(value: int, refused: int = 0xFFFF) -> bytes:
    """Encodes a number whose range the finger knows.

    One that 16 bits cannot hold becomes ``refused``, which the finger refuses with that range.
    """
    return _u16(value if 0 <= value <= 0xFFFF else refused)


def _u16(value: int) -> bytes:
    if not 0 <= value <= 0xFFFF:
        raise ValueError(f"{value} does not fit: expected 0…65535")
    return write_varint(value)

"""Types of docs/protocol.md, section "Types": postcard 1.x, read from and written to bytes.

A reader takes the buffer and a position and returns the value and the position after it. Past the end it
raises ``IndexError`` or ``struct.error``; :func:`taxel.replies.decode` turns both into one error.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from typing import Any, TypeVar

T = TypeVar("T")
Read = Callable[[bytes, int], tuple[T, int]]

_F32 = Struct("<f")
_CODE = Struct("<H")


def u8(data: bytes, at: int) -> tuple[int, int]:
    return data[at], at + 1


def boolean(data: bytes, at: int) -> tuple[bool, int]:
    value = data[at]
    if value > 1:
        raise ValueError(f"a bool of {value}")
    return value == 1, at + 1


def varint(data: bytes, at: int) -> tuple[int, int]:
    byte = data[at]
    at += 1
    if byte < 0x80:
        return byte, at
    value, shift = byte & 0x7F, 7
    while byte >= 0x80:
        if shift > 63:
            raise ValueError("a varint without end")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        shift += 7
    return value, at


def code(data: bytes, at: int) -> tuple[int, int]:
    return _CODE.unpack_from(data, at)[0], at + 2


def f32(data: bytes, at: int) -> tuple[float, int]:
    return _F32.unpack_from(data, at)[0], at + 4


def text(data: bytes, at: int) -> tuple[str, int]:
    raw, at = blob(data, at)
    return raw.decode(), at


def blob(data: bytes, at: int) -> tuple[bytes, int]:
    length, at = varint(data, at)
    if at + length > len(data):
        raise IndexError("bytes past the end")
    return data[at : at + length], at + length


def variant(names: tuple[Any, ...], data: bytes, at: int) -> tuple[Any, int]:
    """``enum`` without fields."""
    number, at = varint(data, at)
    if number >= len(names):
        raise ValueError(f"variant {number} of {len(names)}")
    return names[number], at


def array(layout: str) -> Read[tuple[Any, ...]]:
    """``[f32; N]`` is ``array("<Nf")``, ``[code; N]`` is ``array("<NH")``."""
    struct = Struct(layout)

    def read(data: bytes, at: int) -> tuple[tuple[Any, ...], int]:
        return struct.unpack_from(data, at), at + struct.size

    return read


def option(inner: Read[T]) -> Read[T | None]:
    def read(data: bytes, at: int) -> tuple[T | None, int]:
        present = data[at]
        if present > 1:
            raise ValueError(f"an option of {present}")
        return inner(data, at + 1) if present else (None, at + 1)

    return read


def times(count: int, inner: Read[T]) -> Read[tuple[T, ...]]:
    def read(data: bytes, at: int) -> tuple[tuple[T, ...], int]:
        values = []
        for _ in range(count):
            value, at = inner(data, at)
            values.append(value)
        return tuple(values), at

    return read


def write_varint(value: int) -> bytes:
    if value < 0:
        raise ValueError(f"{value} is below 0")
    written = bytearray()
    while value >= 0x80:
        written.append(value & 0x7F | 0x80)
        value >>= 7
    written.append(value)
    return bytes(written)

"""Packets: docs/protocol.md, section "A packet"."""

from __future__ import annotations

from collections.abc import Iterator
from zlib import crc32

from cobs import cobs

MAX_PACKET = 448
"""Largest number of bytes of a packet, with its COBS bytes and its final zero."""


def pack(message: bytes) -> bytes:
    """Returns a message as bytes on the wire, with the final zero."""
    packet: bytes = cobs.encode(message + crc32(message).to_bytes(4, "little")) + b"\0"
    if len(packet) > MAX_PACKET:
        raise ValueError(f"a packet of {len(packet)} bytes; at most {MAX_PACKET} fit")
    return packet


class Deframer:
    """Finds messages in a stream of bytes, wherever it begins.

    ``bad_packets`` counts dropped packets: wrong COBS, wrong CRC, or too long. Bytes before the first good
    packet do not count, because a stream may be joined in the middle.
    """

    def __init__(self) -> None:
        self.bad_packets = 0
        self._rest = bytearray()
        self._synchronised = False
        self._too_long = False

    def push(self, received: bytes) -> Iterator[bytes]:
        """Yields the messages that ``received`` completes, without COBS and CRC."""
        *packets, rest = received.split(b"\0")
        for packet in packets:
            if self._rest or self._too_long:
                packet = bytes(self._rest) + packet
                self._rest.clear()
            message = None if self._too_long else _unpack(packet)
            was_empty, self._too_long = not packet and not self._too_long, False
            if was_empty:
                continue
            if message is None:
                self.bad_packets += self._synchronised
            else:
                self._synchronised = True
                yield message
        self._rest += rest
        if len(self._rest) >= MAX_PACKET:
            # No packet is so long; dropping it keeps noise without zeros from filling the memory.
            self._rest.clear()
            self._too_long = True


def _unpack(packet: bytes) -> bytes | None:
    if len(packet) >= MAX_PACKET:
        return None
    try:
        body: bytes = cobs.decode(packet)
    except cobs.DecodeError:
        return None
    message, checksum = body[:-4], body[-4:]
    good = len(checksum) == 4 and message and crc32(message) == int.from_bytes(checksum, "little")
    return message if good else None

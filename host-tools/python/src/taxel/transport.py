"""Ports of a finger: a serial device, or ``tcp:HOST:PORT``."""

from __future__ import annotations

import socket
from typing import Protocol

import serial

from .errors import LinkError

POLL = 0.1
"""Longest wait of a read in seconds, so that the reading thread can end."""

READ = 65536

BAUD = 1_000_000
"""Baud rate of a UART; USB ignores it."""


class Transport(Protocol):
    """Two streams of bytes; ``read`` and ``write`` raise :class:`LinkError` once the finger is disconnected.

    ``read`` returns the available bytes, or none after :data:`POLL` seconds.
    """

    def read(self) -> bytes: ...
    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


class SerialTransport:
    """A serial device by its name in the operating system."""

    def __init__(self, name: str) -> None:
        self._name = name
        try:
            # 8N1 is pyserial's default. A second program on the port would steal the finger's bytes.
            self._port = serial.Serial(name, baudrate=BAUD, timeout=POLL, write_timeout=1, exclusive=True)
        except (serial.SerialException, ValueError, OSError) as error:
            raise LinkError(f"{name}: {_reason(error)}") from error

    def read(self) -> bytes:
        try:
            data: bytes = self._port.read(max(1, min(self._port.in_waiting, READ)))
        except (serial.SerialException, OSError, TypeError) as error:
            # pyserial raises a TypeError on its own closed handle.
            raise LinkError(f"{self._name}: the finger has gone; plug it in again") from error
        return data

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as error:
            raise LinkError(f"{self._name}: the finger takes no bytes; plug it in again") from error

    def close(self) -> None:
        self._port.close()


class TcpTransport:
    """A finger behind a TCP connection."""

    def __init__(self, host: str, port: int) -> None:
        self._name = f"tcp:{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout=5)
        except OSError as error:
            raise LinkError(f"{self._name}: {_reason(error)}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(POLL)

    def read(self) -> bytes:
        try:
            data = self._socket.recv(READ)
        except TimeoutError:
            return b""
        except OSError as error:
            raise LinkError(f"{self._name}: {_reason(error)}") from error
        if not data:
            raise LinkError(f"{self._name}: the finger closed the link")
        return data

    def write(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkError(f"{self._name}: {_reason(error)}") from error

    def close(self) -> None:
        self._socket.close()


def connect(port: str) -> Transport:
    """Opens a port: ``/dev/ttyACM0``, ``COM3`` or ``tcp:HOST:PORT``."""
    if not port.startswith("tcp:"):
        return SerialTransport(port)
    host, _, number = port.removeprefix("tcp:").rpartition(":")
    if not host or not number.isdecimal() or not 0 < int(number) < 65536:
        raise LinkError(f"{port}: not HOST:PORT; write for example tcp:192.168.1.20:5000")
    return TcpTransport(host.strip("[]"), int(number))


def _reason(error: BaseException) -> str:
    text = str(error).replace("\n", " ")
    if isinstance(error, PermissionError) or "Permission denied" in text:
        return "permission denied; allow it with the udev rule of the manual, or join the group dialout"
    if "No such file" in text or "could not open port" in text and "FileNotFound" in text:
        return "there is no such device; is it plugged in?"
    if "exclusively lock" in text:
        return "another program has it open; end that one first"
    return text

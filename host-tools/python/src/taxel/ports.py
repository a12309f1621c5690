"""Fingers that a host can find: on USB by their descriptors, and simulated ones."""

from __future__ import annotations

import shutil
import subprocess
from typing import NamedTuple

from serial.tools import list_ports

from .errors import LinkError
from .transport import TcpTransport, Transport, connect

VENDOR, PRODUCT, MANUFACTURER = 0x1209, 0x0001, "taxel"
"""USB descriptors of a finger; the vendor id is shared, so that the manufacturer is checked too."""


class Found(NamedTuple):
    """Finger on USB."""

    serial: str
    """Serial number, for the port ``usb:SERIAL``."""
    port: str
    """Serial device."""


def fingers() -> list[Found]:
    """Returns the fingers on USB."""
    ports = (port for port in list_ports.comports() if (port.vid, port.pid) == (VENDOR, PRODUCT))
    found = (
        Found(port.serial_number or "", port.device) for port in ports if port.manufacturer == MANUFACTURER
    )
    return sorted(found, key=lambda finger: finger.port)


def usb(serial: str | None = None) -> str:
    """Returns the serial device of the finger with this serial number, or of the only one."""
    found = fingers()
    names = ", ".join(f"usb:{finger.serial} ({finger.port})" for finger in found)
    if not found:
        raise LinkError("usb: no finger found; plug it in, or use sim:tour for a simulated one")
    if serial is None and len(found) > 1:
        raise LinkError(f"usb: several fingers found; choose from {names}")
    for finger in found:
        if serial is None or finger.serial == serial:
            return finger.port
    raise LinkError(f"usb:{serial}: no such finger; found are {names}")


class SimulatedTransport(TcpTransport):
    """A virtual finger of the ``taxel`` command, which runs as long as it is open."""

    def __init__(self, port: str) -> None:
        command = shutil.which("taxel")
        if command is None:
            raise LinkError(
                f"{port}: needs the `taxel` command on the PATH; `cargo install --path host-tools/cli`"
            )
        serve = [command, "serve", "--port", port, "--tcp", "127.0.0.1:0"]
        self._process = subprocess.Popen(serve, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self._process.stdout is not None and self._process.stderr is not None
        address = self._process.stdout.readline().strip()
        if not address:
            raise LinkError(f"{port}: {' '.join(self._process.stderr.read().split())}")
        host, _, number = address.removeprefix("tcp:").rpartition(":")
        super().__init__(host, int(number))

    def close(self) -> None:
        super().close()
        self._process.terminate()
        self._process.communicate()


def open_port(port: str) -> Transport:
    """Opens ``usb``, ``usb:SERIAL``, ``sim:SCENE``, ``tcp:HOST:PORT`` or a serial device."""
    if port == "usb" or port.startswith("usb:"):
        return connect(usb(port[4:] or None))
    return SimulatedTransport(port) if port.startswith("sim:") else connect(port)

"""Tests of finding fingers: on USB, and simulated ones."""

import os
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

import taxel
from taxel import Finger, LinkError
from taxel.ports import MANUFACTURER, PRODUCT, VENDOR, usb


def plug(patch: pytest.MonkeyPatch, *ports: tuple[str, str, str]) -> None:
    listed = [
        SimpleNamespace(device=device, serial_number=serial, manufacturer=maker, vid=VENDOR, pid=PRODUCT)
        for device, serial, maker in ports
    ]
    patch.setattr(list_ports, "comports", lambda: listed)


def test_only_finger_on_usb_is_found(monkeypatch: pytest.MonkeyPatch):
    plug(monkeypatch, ("/dev/ttyACM1", "F-2", MANUFACTURER), ("/dev/ttyACM0", "X", "another"))
    assert usb() == usb("F-2") == "/dev/ttyACM1"
    assert taxel.fingers() == [("F-2", "/dev/ttyACM1")]


def test_several_fingers_are_an_error_that_names_them(monkeypatch: pytest.MonkeyPatch):
    plug(monkeypatch, ("/dev/ttyACM0", "F-1", MANUFACTURER), ("/dev/ttyACM1", "F-2", MANUFACTURER))
    with pytest.raises(LinkError, match=r"usb:F-1 \(/dev/ttyACM0\), usb:F-2 \(/dev/ttyACM1\)"):
        Finger()
    with pytest.raises(LinkError, match="usb:F-3: no such finger; found are usb:F-1"):
        Finger("usb:F-3")


def test_no_finger_is_an_error_that_says_what_to_do(monkeypatch: pytest.MonkeyPatch):
    plug(monkeypatch)
    with pytest.raises(LinkError, match="no finger found; plug it in, or use sim:tour"):
        Finger()


@pytest.fixture
def on_path(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = os.path.dirname(os.path.abspath(command))
    monkeypatch.setenv("PATH", folder + os.pathsep + os.environ["PATH"])


def test_simulated_finger_is_served_by_the_command(on_path: None):
    with Finger("sim:press") as finger:
        assert finger.info().serial == "press"
        assert len(list(finger.frames(seconds=0.2))) >= 200


def test_unknown_scene_is_the_commands_error(on_path: None):
    with pytest.raises(LinkError, match="sim:nosuch: .*nosuch"):
        Finger("sim:nosuch")


def test_simulated_finger_without_the_command_says_so(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(LinkError, match="needs the `taxel` command on the PATH"):
        Finger("sim:tour")

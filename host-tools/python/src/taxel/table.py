"""Frames as columns, named as in the frames CSV of ``taxel record``."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .messages import Fields, Force, Frame, Newtons, Point, Slip, Status, Uncertainty

if TYPE_CHECKING:
    import pandas

Columns = dict[str, npt.NDArray[Any]]

_AXES = "xyz"
_FORCE = [f"f{axis}_n" for axis in _AXES]
_SENSORS = [f"s{i}_f{axis}_n" for i in range(4) for axis in _AXES]
_SIGNALS = [
    *(f"c_r{k // 4}c{k % 4}" for k in range(16)),
    *(f"s{i}_u{axis}" for i in range(4) for axis in _AXES),
]
_CONTACTS = [f"contact{i}_{name}" for i in (1, 2) for name in ("x_mm", "y_mm", "fz_n")]
_UNCERTAINTY = [*(f"f{axis}_sigma_n" for axis in _AXES), "x_sigma_mm", "y_sigma_mm", "misfit"]
_HEALTH = ["saturated", "dead", "bridge_faults"]
_CODES = [
    *(f"lit_r{k // 4}c{k % 4}" for k in range(16)),
    *(f"dark_c{c}" for c in range(4)),
    *(f"bridge_s{i}_{midpoint}" for i in range(4) for midpoint in "abcd"),
    "aux_vref",
    "aux_temp",
]


def columns(frames: Iterable[Frame], fields: Fields) -> Columns:
    """An array a column: ``t_us``, ``seq``, ``status``, ``contact``, then those of ``fields``.

    A value that the finger did not give is NaN here, because an array has no room for the reason; the
    frames themselves have it.
    """
    rows = list(frames)
    table: Columns = {
        "t_us": np.array([frame.time_us for frame in rows], dtype=np.uint64),
        "seq": np.array([frame.seq for frame in rows], dtype=np.uint32),
        "status": np.array([int(frame.status) for frame in rows], dtype=np.uint32),
    }
    if Fields.FORCE in fields:
        _add(table, _FORCE, rows, lambda frame: _force(frame.force))
    if Fields.POINT in fields:
        _add(table, ["x_mm", "y_mm"], rows, _point)
    if Fields.TORSION in fields:
        _add(table, ["torsion_nmm"], rows, lambda frame: [_value(frame.torsion_nmm)])
    table["contact"] = np.array([frame.in_contact for frame in rows], dtype=np.uint8)
    if Fields.SLIP in fields:
        table["slip"] = np.array([bool(frame.status & Status.SLIDES) for frame in rows], dtype=np.uint8)
        _add(table, ["slip_margin", "friction", "grip_n"], rows, _slip)
    if Fields.CONTACTS in fields:
        _add(table, _CONTACTS, rows, _contacts)
    if Fields.UNCERTAINTY in fields:
        _add(table, _UNCERTAINTY, rows, _uncertainty)
    if Fields.SENSORS in fields:
        _add(table, _SENSORS, rows, _sensors)
    if Fields.SIGNALS in fields:
        _add(table, _SIGNALS + _HEALTH, rows, _signals)
    if Fields.CODES in fields:
        _add(table, _CODES, rows, _codes)
    return table


def data_frame(frames: Iterable[Frame], fields: Fields) -> pandas.DataFrame:
    """:func:`columns` as a ``pandas.DataFrame``, indexed by device time in seconds."""
    import pandas

    table = pandas.DataFrame(columns(frames, fields))
    return table.set_index(table["t_us"].to_numpy() / 1e6).rename_axis("t_s")


def _add(table: Columns, names: list[str], rows: list[Frame], row: Callable[[Frame], list[float]]) -> None:
    values = np.array([row(frame) for frame in rows], dtype=np.float64).reshape(len(rows), len(names))
    for i, name in enumerate(names):
        table[name] = values[:, i]


def _value(value: Newtons | None) -> float:
    return value if isinstance(value, float) else nan


def _force(force: Force | None) -> list[float]:
    return [nan] * 3 if force is None else [_value(value) for value in force]


def _point(frame: Frame) -> list[float]:
    return list(frame.point) if isinstance(frame.point, Point) else [nan] * 2


def _slip(frame: Frame) -> list[float]:
    return list(frame.slip) if isinstance(frame.slip, Slip) else [nan] * 3


def _contacts(frame: Frame) -> list[float]:
    if not isinstance(frame.contacts, tuple):
        return [nan] * len(_CONTACTS)
    return [value for contact in frame.contacts for value in (*contact.point, contact.normal_n)]


def _uncertainty(frame: Frame) -> list[float]:
    sure = frame.uncertainty
    if not isinstance(sure, Uncertainty):
        return [nan] * len(_UNCERTAINTY)
    point = sure.point if isinstance(sure.point, Point) else [nan] * 2
    return [*_force(sure.force), *point, _value(sure.misfit)]


def _sensors(frame: Frame) -> list[float]:
    return [value for force in frame.sensors or [None] * 4 for value in _force(force)]


def _signals(frame: Frame) -> list[float]:
    signals = frame.signals
    if signals is None:
        return [nan] * len(_SIGNALS + _HEALTH)
    bridges = [value for bridge in signals.bridges for value in bridge or [nan] * 3]
    return [*(signals.taxels or [nan] * 16), *bridges, signals.saturated, signals.dead, signals.bridge_faults]


def _codes(frame: Frame) -> list[float]:
    codes = frame.codes
    if codes is None:
        return [nan] * len(_CODES)
    bridges = [value for bridge in codes.bridges for value in bridge or [nan] * 4]
    aux = [nan if code is None else code for code in (codes.reference, codes.temperature)]
    return [*(codes.lit or [nan] * 16), *(codes.dark or [nan] * 4), *bridges, *aux]

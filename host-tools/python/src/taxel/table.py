"""Frames as columns, named as in the frames CSV of ``taxel record``."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import nan
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .messages import Fields, Frame, Status

if TYPE_CHECKING:
    import pandas

Columns = dict[str, npt.NDArray[Any]]


def columns(frames: Iterable[Frame], fields: Fields) -> Columns:
    """Returns an array for each column: ``t_us``, ``seq``, ``status``, ``contact``, then those of ``fields``.

    A missing value is NaN, because an array has no room for the reason; the frames hold it.
    """
    rows = list(frames)
    table: Columns = {
        "t_us": np.array([frame.time_us for frame in rows], dtype=np.uint64),
        "seq": np.array([frame.seq for frame in rows], dtype=np.uint32),
        "status": np.array([int(frame.status) for frame in rows], dtype=np.uint32),
    }
    for group in _GROUPS:
        if group.fields not in fields:
            continue
        if isinstance(group, _Flag):
            held = [bool(frame.status & group.bit) for frame in rows]
            table[group.column] = np.array(held, dtype=np.uint8)
        else:
            _add(table, group.columns.split(), rows, group.row)
    return table


def data_frame(frames: Iterable[Frame], fields: Fields) -> pandas.DataFrame:
    """Returns :func:`columns` as a ``pandas.DataFrame``, indexed by device time in seconds."""
    import pandas

    table = pandas.DataFrame(columns(frames, fields))
    return table.set_index(table["t_us"].to_numpy() / 1e6).rename_axis("t_s")


def _add(table: Columns, names: list[str], rows: list[Frame], row: Callable[[Frame], list[float]]) -> None:
    values = np.array([row(frame) for frame in rows], dtype=np.float64).reshape(len(rows), len(names))
    for i, name in enumerate(names):
        table[name] = values[:, i]


def _flat(value: Any, shape: Any) -> list[float]:
    """Lists the numbers of ``value``, NaN for a missing one; a shape is 1 or a tuple of shapes."""
    if shape == 1:
        return [value if isinstance(value, float) else nan]
    parts = value if isinstance(value, tuple) else [None] * len(shape)
    return [number for part, inner in zip(parts, shape, strict=True) for number in _flat(part, inner)]


def _signals(frame: Frame) -> list[float]:
    signals = frame.signals
    if signals is None:
        return [nan] * 31
    bridges = [value for bridge in signals.bridges for value in bridge or [nan] * 3]
    return [*(signals.taxels or [nan] * 16), *bridges, signals.saturated, signals.dead, signals.bridge_faults]


def _codes(frame: Frame) -> list[float]:
    codes = frame.codes
    if codes is None:
        return [nan] * 38
    bridges = [value for bridge in codes.bridges for value in bridge or [nan] * 4]
    aux = [nan if code is None else code for code in (codes.reference, codes.temperature)]
    return [*(codes.lit or [nan] * 16), *(codes.dark or [nan] * 4), *bridges, *aux]


class _Field(NamedTuple):
    fields: Fields
    row: Callable[[Frame], list[float]]
    columns: str


class _Flag(NamedTuple):
    column: str
    bit: Status
    fields: Fields


_GROUPS: tuple[_Field | _Flag, ...] = (
    # schema: columns (from src/frame/schema.rs by `cargo xtask protocol`)
    _Field(
        Fields.FORCE,
        lambda frame: _flat(frame.force, (1, 1, 1)),
        "fx_n fy_n fz_n",
    ),
    _Field(
        Fields.POINT,
        lambda frame: _flat(frame.point, (1, 1)),
        "x_mm y_mm",
    ),
    _Field(
        Fields.TORSION,
        lambda frame: _flat(frame.torsion_nmm, 1),
        "torsion_nmm",
    ),
    _Flag("contact", Status.CONTACT, Fields(0)),
    _Flag("slip", Status.SLIDES, Fields.SLIP),
    _Field(
        Fields.SLIP,
        lambda frame: _flat(frame.slip, (1, 1, 1)),
        "slip_margin friction grip_n",
    ),
    _Field(
        Fields.CONTACTS,
        lambda frame: _flat(frame.contacts, (((1, 1), 1), ((1, 1), 1))),
        "contact1_x_mm contact1_y_mm contact1_fz_n contact2_x_mm contact2_y_mm contact2_fz_n",
    ),
    _Field(
        Fields.UNCERTAINTY,
        lambda frame: _flat(frame.uncertainty, ((1, 1, 1), (1, 1), 1)),
        "fx_sigma_n fy_sigma_n fz_sigma_n x_sigma_mm y_sigma_mm misfit",
    ),
    _Field(
        Fields.SENSORS,
        lambda frame: _flat(frame.sensors, ((1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1))),
        "s0_fx_n s0_fy_n s0_fz_n s1_fx_n s1_fy_n s1_fz_n s2_fx_n s2_fy_n s2_fz_n s3_fx_n s3_fy_n s3_fz_n",
    ),
    _Field(
        Fields.SIGNALS,
        _signals,
        "c_r0c0 c_r0c1 c_r0c2 c_r0c3 c_r1c0 c_r1c1 c_r1c2 c_r1c3 c_r2c0 c_r2c1 c_r2c2 c_r2c3 c_r3c0 c_r3c1 "
        "c_r3c2 c_r3c3 s0_ux s0_uy s0_uz s1_ux s1_uy s1_uz s2_ux s2_uy s2_uz s3_ux s3_uy s3_uz saturated "
        "dead bridge_faults",
    ),
    _Field(
        Fields.CODES,
        _codes,
        "lit_r0c0 lit_r0c1 lit_r0c2 lit_r0c3 lit_r1c0 lit_r1c1 lit_r1c2 lit_r1c3 lit_r2c0 lit_r2c1 "
        "lit_r2c2 lit_r2c3 lit_r3c0 lit_r3c1 lit_r3c2 lit_r3c3 dark_c0 dark_c1 dark_c2 dark_c3 bridge_s0_a "
        "bridge_s0_b bridge_s0_c bridge_s0_d bridge_s1_a bridge_s1_b bridge_s1_c bridge_s1_d bridge_s2_a "
        "bridge_s2_b bridge_s2_c bridge_s2_d bridge_s3_a bridge_s3_b bridge_s3_c bridge_s3_d aux_vref "
        "aux_temp",
    ),
    # schema: end
)

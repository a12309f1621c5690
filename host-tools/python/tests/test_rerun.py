"""Tests of the Rerun example: its files read by Rerun's own reader."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_examples import run

import taxel
from taxel import Status

if sys.version_info < (3, 11):
    pytest.skip("rerun-sdk needs Python 3.11", allow_module_level=True)

import rerun as rr

EXAMPLE = "show_in_rerun.py"


def shown(path: Path) -> Any:
    """Returns a recording of Rerun as a data frame, a row for each device time."""
    reader = rr.chunk.RrdReader(path)
    (recording,) = reader.recordings()
    assert len(reader.blueprints()) == 1
    store = reader.stream(store=recording).collect()
    return store.reader(index="device_time").to_pandas().sort_values("device_time")


def cells(column: Any) -> list[Any]:
    """Lists what a column draws in each row: no element where there is nothing."""
    return [[] if cell is None else [np.asarray(part) for part in cell] for cell in column]


def scalars(rows: Any, name: str) -> Any:
    return np.array([cell[0] for cell in cells(rows[f"/{name}:Scalars:scalars"])])


@pytest.fixture(scope="module")
def recorded(command: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rerun") / "fault.mcap"
    record = [command, "record", "--port", "sim:fault", "--fields", "all", "--duration", "4"]
    subprocess.run([*record, "--out", str(path)], check=True)
    return path


def test_rerun_shows_force_and_place_of_a_recording(command: str, recorded: Path):
    run(command, EXAMPLE, recorded, "--save", "fault.rrd", cwd=recorded.parent)
    rows, press = shown(recorded.with_suffix(".rrd")), taxel.read(recorded)
    assert list(rows["device_time"].dt.total_seconds() * 1e6) == pytest.approx(list(press["t_us"]), abs=0.5)
    force = np.stack([press[name] for name in ("fx_n", "fy_n", "fz_n")], axis=1)
    np.testing.assert_array_equal(scalars(rows, "force/fz_n"), force[:, 2])
    shear = np.sqrt(force[:, 0] ** 2 + force[:, 1] ** 2)
    np.testing.assert_allclose(scalars(rows, "force/shear_n"), shear, rtol=1e-12)
    for name in ("x_mm", "y_mm"):
        np.testing.assert_array_equal(scalars(rows, f"place/{name}"), press[name])
    # The arrow ends at the contact and is 10 mm long for each newton; without both there is none.
    vectors, origins = (cells(rows[f"/force:Arrows3D:{part}"]) for part in ("vectors", "origins"))
    arrows = bare = 0
    for vector, origin, row, x, y in zip(vectors, origins, force, press["x_mm"], press["y_mm"], strict=True):
        if np.isnan(row).any() or np.isnan(x):
            assert not vector and not origin
            bare += 1
        else:
            np.testing.assert_allclose(vector, [10 * row], rtol=1e-6)
            np.testing.assert_allclose(np.add(vector, origin), [[x, y, 0]], atol=1e-5)
            arrows += 1
    assert arrows > 100 and bare > 100, (arrows, bare)


def test_rerun_colours_taxels_by_signal_and_logs_flags(command: str, recorded: Path):
    run(command, EXAMPLE, recorded, "--save", "flags.rrd", cwd=recorded.parent)
    rows, press = shown(recorded.with_name("flags.rrd")), taxel.read(recorded)
    signals = np.stack([press[f"c_r{k // 4}c{k % 4}"] for k in range(16)], axis=1)
    colours = cells(rows["/taxels:Boxes3D:colors"])
    (centres,) = {tuple(map(tuple, cell)) for cell in cells(rows["/taxels:Boxes3D:centers"])}
    assert [centre[:2] for centre in centres[:5]] == [
        (-3.75, -3.75), (-1.25, -3.75), (1.25, -3.75), (3.75, -3.75), (-3.75, -1.25)
    ]  # fmt: skip
    # Red of RGBA grows with the signal.
    strongest = np.nanargmax(np.abs(signals).max(axis=1))
    red = np.array([int(colour) >> 24 for colour in colours[strongest]])
    order = np.argsort(np.abs(signals[strongest]))
    assert len(red) == 16 and (np.diff(red[order]) >= 0).all() and red.max() > red.min() + 50
    texts = cells(rows["/flags:TextLog:text"])
    levels = cells(rows["/flags:TextLog:level"])
    first = next(i for i, text in enumerate(texts) if "dead taxel" in map(str, text))
    assert levels[first][texts[first].index("dead taxel")] == "ERROR"
    dead = press["status"] & int(Status.DEAD_TAXEL) != 0
    assert first == np.flatnonzero(dead)[0] > 0


def test_rerun_shows_a_live_finger_in_device_time(command: str, tmp_path: Path):
    words = ["sim:press", "--seconds", 2, "--save", "live.rrd"]
    said = run(command, EXAMPLE, *words, cwd=tmp_path)
    rows = shown(tmp_path / "live.rrd")
    times = rows["device_time"].dt.total_seconds().to_numpy()
    assert f"sim:press: {len(rows)} frames" in said and len(rows) > 1900
    assert (np.diff(times) > 0).all() and times[-1] - times[0] == pytest.approx(2, abs=0.05)
    assert np.nanmax(scalars(rows, "force/fz_n")) > 0.5
    refused = run(command, EXAMPLE, *words, cwd=tmp_path, code=1)
    assert "live.rrd exists; delete it, or give --save another name" in refused

"""Tests of the examples: each runs as a program against virtual fingers and recordings."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fingers import ROOT, serve
from test_stream import frame

import taxel
from taxel import NoValue, Slip, Status

EXAMPLES = ROOT / "host-tools/python/examples"
sys.path.insert(0, str(EXAMPLES))


def run(command: str, name: str, *words: object, cwd: Path, code: int = 0) -> str:
    path = os.path.dirname(os.path.abspath(command)) + os.pathsep + os.environ["PATH"]
    program = [sys.executable, str(EXAMPLES / name), *map(str, words)]
    done = subprocess.run(
        program, cwd=cwd, env={**os.environ, "PATH": path}, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_grip_controller_grips_harder_when_shear_grows(command: str, tmp_path: Path):
    said = run(command, "grip.py", "--port", "sim:shear-ramp", "--seconds", 6, cwd=tmp_path)
    steps, within = re.search(r"(\d+) steps, latest\(\) within ([\d.]+) ms", said).groups()  # type: ignore[union-attr]
    assert int(steps) == 6000 and float(within) <= 2
    highest = re.search(r"grip up to ([\d.]+) N", said)
    assert highest is not None and float(highest[1]) > 0.5, said
    assert " 0 lost" in said


def test_grip_follows_friction_up_at_once_and_down_slowly():
    from grip import LEAST_N, MOST_N, next_grip

    touch = frame(1)._replace(status=Status.CONTACT, slip=Slip(0.5, 0.6, 2.0))
    assert next_grip(1.0, touch) == 2.0
    assert next_grip(3.0, touch) == pytest.approx(3.0 - 0.5e-3)
    assert next_grip(3.0, touch._replace(status=Status.SLIP_WARNING)) == pytest.approx(3.02)
    assert next_grip(1.0, touch._replace(slip=Slip(0.0, 0.6, 90.0))) == MOST_N
    assert next_grip(0.0, touch._replace(slip=Slip(1.0, 0.6, 0.0))) == LEAST_N
    for missing in (NoValue.NO_CONTACT, NoValue.ILL_CONDITIONED, None):
        assert next_grip(1.5, touch._replace(slip=missing)) == 1.5


def test_logger_writes_two_fingers_on_one_clock(command: str, tmp_path: Path):
    said = run(command, "log.py", "sim:tour", "sim:press", "--seconds", 2, "--folder", "today", cwd=tmp_path)
    tour, press = (taxel.read(tmp_path / f"today/sim-{name}.csv") for name in ("tour", "press"))
    for name, rows in (("tour", tour), ("press", press)):
        assert f"sim:{name}: {len(rows)} rows in today/sim-{name}.csv, 0 lost" in said
        assert rows.facts["serial"] == name and len(rows) >= 1900
    both = [rows["host_scan_us"][~np.isnan(rows["host_scan_us"])] for rows in (tour, press)]
    assert min(each[-1] for each in both) > max(each[0] for each in both)


def test_logger_keeps_the_file_when_a_finger_goes(command: str, tmp_path: Path):
    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as port:
        program = subprocess.Popen(
            [sys.executable, EXAMPLES / "log.py", port], cwd=tmp_path, stdout=subprocess.PIPE, text=True
        )
        assert program.stdout is not None and "rows, 0 lost" in program.stdout.readline()
    assert program.wait(30) == 1
    assert "the finger closed the link" in program.stdout.read() or program.returncode == 1
    (path,) = tmp_path.glob("*.csv")
    assert len(taxel.read(path)) > 0


@pytest.fixture(scope="module")
def recordings(command: str, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("dataset")
    for scene in ("press", "tour"):
        record = [command, "record", "--port", f"sim:{scene}", "--fields", "all", "--duration", "2"]
        subprocess.run([*record, "--out", f"{scene}.mcap"], cwd=folder, check=True)
    return [folder / "press.mcap", folder / "tour.mcap"]


def test_lerobot_dataset_holds_the_newest_values_at_its_rate(
    command: str, recordings: list[Path], tmp_path: Path
):
    words = [*recordings, "--task", "press", "--fps", 50, "--lerobot", "set"]
    said = run(command, "export_dataset.py", *words, cwd=tmp_path)
    assert "set: 2 episodes, 200 frames at 50 Hz" in said
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert (info["codebase_version"], info["total_frames"], info["fps"]) == ("v3.0", 200, 50)
    data = pd.read_parquet(tmp_path / "set" / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(data.columns) == set(info["features"]) and len(data) == 200
    names = info["features"]["observation.tactile"]["names"]
    assert info["features"]["observation.tactile"]["shape"] == [len(names)]
    episodes = pd.read_parquet(tmp_path / "set/meta/episodes/chunk-000/file-000.parquet")
    assert list(episodes["dataset_from_index"]) == [0, 100] and list(episodes["length"]) == [100, 100]
    tasks = pd.read_parquet(tmp_path / "set/meta/tasks.parquet")
    assert tasks.loc["press", "task_index"] == 0
    tactile, valid = np.stack(data["observation.tactile"]), np.stack(data["observation.tactile_valid"])
    for number, path in enumerate(recordings):
        rows = taxel.read(path)
        for i, name in enumerate(names):
            ours = rows[name][::20].astype(np.float32)
            theirs = tactile[100 * number : 100 * (number + 1), i]
            np.testing.assert_array_equal(np.nan_to_num(ours), theirs, err_msg=name)
            np.testing.assert_array_equal(~np.isnan(ours), valid[100 * number : 100 * (number + 1), i])
    stats = json.loads((tmp_path / "set/meta/stats.json").read_text())
    assert stats["observation.tactile"]["max"][names.index("fz_n")] == pytest.approx(tactile[:, 2].max())
    assert "export_dataset: " in run(command, "export_dataset.py", *words, cwd=tmp_path, code=1)


def test_hdf5_holds_every_column_reason_and_fact(command: str, recordings: list[Path], tmp_path: Path):
    import h5py

    run(command, "export_dataset.py", *recordings, "--hdf5", "all.h5", cwd=tmp_path)
    with h5py.File(tmp_path / "all.h5") as file:
        for number, path in enumerate(recordings):
            group, rows = file[f"episode_{number}"], taxel.read(path)
            assert group.attrs["serial"] == rows.facts["serial"]
            assert group.attrs["calibration"] == rows.calibration
            for name, column in rows.columns.items():
                np.testing.assert_array_equal(group[name], column, err_msg=name)
            for name, reasons in rows.reasons.items():
                np.testing.assert_array_equal(group[f"{name}_withheld"].asstr()[:], reasons, err_msg=name)

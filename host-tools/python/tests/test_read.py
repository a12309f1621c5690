"""Tests of recordings as arrays: those of `taxel record`, and the package's own recorder."""

import csv
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fingers import CALIBRATION, serve

import taxel
from taxel import Fields, Finger, RecordingError


@pytest.fixture(scope="module")
def folder(command: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("read")
    record = [command, "record", "--port", "sim:press", "--fields", "all", "--duration", "2"]
    files = [word for name in ("a.mcap", "a.parquet", "a.csv") for word in ("--out", name)]
    subprocess.run([*record, *files], cwd=folder, check=True)
    return folder


def test_three_formats_give_the_same_arrays(folder: Path):
    mcap, parquet, table = (taxel.read(folder / f"a.{kind}") for kind in ("mcap", "parquet", "csv"))
    assert len(mcap) == 2000 and list(mcap.columns) == list(parquet.columns) == list(table.columns)
    for name, column in mcap.columns.items():
        assert column.dtype == parquet[name].dtype == table[name].dtype
        np.testing.assert_array_equal(column, parquet[name], err_msg=name)
        np.testing.assert_array_equal(column, table[name], err_msg=name)
    assert np.nanmax(mcap["fz_n"]) > 0.5 and mcap["t_us"].dtype == np.uint64
    assert np.diff(mcap.time_s) == pytest.approx(1e-3)


def test_recording_tells_reasons_finger_and_calibration(folder: Path):
    mcap, parquet = taxel.read(folder / "a.mcap"), taxel.read(folder / "a.parquet")
    assert mcap.facts == parquet.facts and mcap.facts["serial"] == "press"
    assert mcap.calibration == parquet.calibration and "taxel_calibration" in str(mcap.calibration)
    assert mcap.reasons.keys() == parquet.reasons.keys()
    for name, reasons in mcap.reasons.items():
        np.testing.assert_array_equal(reasons, parquet.reasons[name], err_msg=name)
        np.testing.assert_array_equal(reasons != "", np.isnan(mcap[name]), err_msg=name)
    assert "no contact" in mcap.reasons["x_mm"]
    assert mcap.data_frame().index.name == "t_s"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("none.mcap", None, "No such file"),
        ("a.txt", b"", r"expected .mcap, .parquet or .csv"),
        ("b.csv", b"t_us,seq\n1,2\n1\n", r"b.csv:3: 1 columns, expected 2"),
        ("c.csv", b"t_us,fx_n\n1,much\n", "column fx_n: .*'much'"),
        ("d.csv", b"a,b\n1,2\n", "column t_us is missing"),
        ("e.parquet", b"nothing", "e.parquet: "),
        (
            "f.mcap",
            b"nothing at all, and no MCAP",
            "damaged or cut off .*; no frame of it can be read: record again",
        ),
    ],
)
def test_unreadable_file_is_an_error_in_one_line(tmp_path: Path, name: str, content: bytes | None, says: str):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=says) as error:
        taxel.read(tmp_path / name)
    assert "\n" not in str(error.value)


def test_cut_recording_names_the_command_that_saves_it(folder: Path, tmp_path: Path):
    whole = (folder / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordingError, match="`taxel export cut.mcap --out saved.mcap`"):
        taxel.read(tmp_path / "cut.mcap")


def test_recording_cut_before_its_first_frame_is_not_sent_to_export(folder: Path, tmp_path: Path):
    (tmp_path / "cut.mcap").write_bytes((folder / "a.mcap").read_bytes()[:200])
    with pytest.raises(RecordingError, match="no frame of it can be read: record again") as error:
        taxel.read(tmp_path / "cut.mcap")
    assert "export" not in str(error.value)


def test_unknown_column_is_an_error_that_lists_the_fields(folder: Path):
    with pytest.raises(RecordingError, match="no column fz: recorded are codes,signals,sensors"):
        taxel.read(folder / "a.mcap")["fz"]


def test_missing_library_is_an_error_that_names_the_extra(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(RecordingError, match=r"needs the package pyarrow.*\[recordings\]"):
        taxel.read(folder / "a.parquet")


def test_recorder_writes_every_frame_and_taxel_reads_it(command: str, tmp_path: Path):
    """Compares the recording with the received frames, and with the core's estimates of its codes."""
    path = tmp_path / "python.csv"
    with serve(command, "sim:press", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        finger.set_fields(Fields.ALL)
        finger.set_rate(1000)
        with finger.record(path) as recorder:
            frames = list(finger.frames(seconds=2))
            counts = finger.counts
        assert recorder.frames >= counts.frames >= 2000 and counts.lost == 0
    ours = taxel.read(path)
    live = taxel.columns(frames, Fields.ALL)
    assert set(np.diff(ours["seq"].astype(int))) == {1}
    rows = slice(0, len(frames))
    for name, column in live.items():
        np.testing.assert_array_equal(ours[name][rows].astype(np.float64), column.astype(np.float64), name)
    assert ours.facts["serial"] == "press" and ours.facts["rate_hz"] == "1000"
    known = ~np.isnan(ours["host_scan_us"])
    assert known.mean() > 0.3 and np.median((ours["host_us"] - ours["host_scan_us"])[known]) > 0
    again = ["replay", path, "--calibration", CALIBRATION, "--fields", "all", "--out", tmp_path / "again.csv"]
    subprocess.run([command, *map(str, again)], check=True, capture_output=True)
    replayed = taxel.read(tmp_path / "again.csv")
    for name in ("fz_n", "x_mm", "slip_margin", "torsion_nmm", "misfit"):
        np.testing.assert_array_equal(replayed[name], ours[name], err_msg=name)
    export = [command, "export", str(path), "--out", str(tmp_path / "python.mcap")]
    subprocess.run(export, check=True, capture_output=True)
    np.testing.assert_array_equal(taxel.read(tmp_path / "python.mcap")["fz_n"], ours["fz_n"])


def test_recorder_has_the_header_of_taxel_record(command: str, folder: Path, tmp_path: Path):
    def header(path: Path) -> tuple[set[str], list[str]]:
        lines = path.read_text().splitlines()
        facts = {line[2:].partition("=")[0] for line in lines if line.startswith("#")}
        return facts, next(csv.reader([next(line for line in lines if not line.startswith("#"))]))

    with serve(command, "sim:press", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        finger.set_fields(Fields.ALL)
        with finger.record(tmp_path / "a.csv"):
            pass
    assert header(tmp_path / "a.csv") == header(folder / "a.csv")


def test_recorder_overwrites_nothing_unasked(command: str, tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text("precious")
    with serve(command, "sim:press", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        with pytest.raises(RecordingError, match="exists already"):
            finger.record(path)
        with pytest.raises(RecordingError, match="ends in .csv; `taxel export`"):
            finger.record(tmp_path / "a.mcap")
        assert path.read_text() == "precious"
        with finger.record(path, overwrite=True):
            finger.latest()
            time.sleep(0.6)
            # A killed program would have left this.
            assert len(path.read_text().splitlines()) > 100


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a full device")
def test_full_disk_is_an_error_at_the_end(command: str, tmp_path: Path):
    path = tmp_path / "full.csv"
    with serve(command, "sim:press", "--tcp", "127.0.0.1:0") as port, Finger(port) as finger:
        with pytest.raises(RecordingError, match="No space left on device; 0 frames"):
            with finger.record(path) as recorder:
                recorder._file.close()
                recorder._file = open("/dev/full", "w")
                finger.latest()
                time.sleep(0.3)

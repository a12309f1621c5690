"""Makes data sets for robot learning of recordings: an episode each, for LeRobot (v3.0) or in HDF5.

    python export_dataset.py grasp1.mcap grasp2.mcap --task "lift the cup" --fps 50 --lerobot dataset
    python export_dataset.py grasp1.mcap grasp2.mcap --hdf5 grasps.h5

LeRobot's frames are at a fixed rate: each holds the newest values at its time. A missing value is 0 there,
and 0 in the mask ``observation.tactile_valid``. Images, states and actions of the robot are not in a finger's
recording; add them by the episodes' times. HDF5 holds every row, NaN and reason as recorded.
Needs: pip install './host-tools/python[pandas,recordings,hdf5]'
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import taxel
from taxel import Recording

TACTILE = ["fx_n", "fy_n", "fz_n", "x_mm", "y_mm", "torsion_nmm", "slip_margin", "contact"]
"""Columns of ``observation.tactile``; those that no recording has are left out."""

FILE = "chunk-000/file-000.parquet"
Array = np.ndarray[Any, np.dtype[Any]]


def resampled(recording: Recording, names: list[str], fps: float) -> tuple[Array, Array]:
    """Returns values at a fixed rate, each the newest at its time, and which of them are there."""
    times = recording.time_s - recording.time_s[0]
    ticks = np.arange(0, times[-1] + 1e-9, 1 / fps)
    rows = np.searchsorted(times, ticks + 1e-9, side="right") - 1
    values = np.stack([recording[name][rows] for name in names], axis=1).astype(np.float32)
    valid = ~np.isnan(values)
    return np.where(valid, values, np.float32(0)), valid.astype(np.float32)


def statistics(values: Array) -> dict[str, list[float]]:
    flat = values.reshape(len(values), -1).astype(np.float64)
    parts = {"min": flat.min(0), "max": flat.max(0), "mean": flat.mean(0), "std": flat.std(0)}
    return {name: part.tolist() for name, part in parts.items()} | {"count": [len(flat)]}


def write_lerobot(recordings: list[Recording], task: str, fps: int, folder: Path) -> int:
    """Writes a LeRobotDataset in format v3.0; returns the number of frames."""
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = [name for name in TACTILE if all(name in each.columns for each in recordings)]
    table: dict[str, list[Array]] = {}
    episodes = []
    total = 0
    for number, recording in enumerate(recordings):
        tactile, valid = resampled(recording, names, fps)
        count = len(tactile)
        parts = {
            "observation.tactile": tactile,
            "observation.tactile_valid": valid,
            "timestamp": (np.arange(count) / fps).astype(np.float32),
            "frame_index": np.arange(count),
            "episode_index": np.full(count, number),
            "index": total + np.arange(count),
            "task_index": np.zeros(count, dtype=np.int64),
        }
        for name, part in parts.items():
            table.setdefault(name, []).append(part)
        episodes.append(
            {"episode_index": number, "tasks": [task], "length": count}
            | {"data/chunk_index": 0, "data/file_index": 0}
            | {"dataset_from_index": total, "dataset_to_index": total + count}
            | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        )
        total += count
    columns = {name: np.concatenate(parts) for name, parts in table.items()}
    features = {
        name: {
            "dtype": str(column.dtype),
            "shape": [column.shape[1] if column.ndim > 1 else 1],
            "names": names if column.ndim > 1 else None,
        }
        for name, column in columns.items()
    }
    info = {
        "codebase_version": "v3.0",
        "robot_type": "taxel",
        "total_episodes": len(recordings),
        "total_frames": total,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(recordings)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
    for path in (folder / "data/chunk-000", folder / "meta/episodes/chunk-000"):
        path.mkdir(parents=True)
    pq.write_table(pa.table({k: list(v) for k, v in columns.items()}), folder / "data" / FILE)
    pq.write_table(pa.Table.from_pylist(episodes), folder / "meta/episodes" / FILE)
    tasks = pd.DataFrame({"task_index": [0]}, index=pd.Index([task], name="task"))
    tasks.to_parquet(folder / "meta/tasks.parquet")
    (folder / "meta/info.json").write_text(json.dumps(info, indent=4))
    stats = {name: statistics(column) for name, column in columns.items()}
    (folder / "meta/stats.json").write_text(json.dumps(stats, indent=4))
    return total


def write_hdf5(recordings: list[Recording], path: Path) -> int:
    """Writes a group for each recording, a data set for each column; returns the number of rows."""
    import h5py

    with h5py.File(path, "x") as file:
        for number, recording in enumerate(recordings):
            group = file.create_group(f"episode_{number}")
            group.attrs.update(recording.facts)
            if recording.calibration is not None:
                group.attrs["calibration"] = recording.calibration
            for name, column in recording.columns.items():
                group.create_dataset(name, data=column, compression="gzip", shuffle=True)
            for name, reasons in recording.reasons.items():
                text = reasons.astype(h5py.string_dtype())
                group.create_dataset(f"{name}_withheld", data=text, compression="gzip")
    return sum(map(len, recordings))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--task", default="touch")
    parser.add_argument("--fps", type=int, default=50)
    parser.add_argument("--lerobot", type=Path, metavar="FOLDER")
    parser.add_argument("--hdf5", type=Path, metavar="FILE")
    words = parser.parse_args()
    if words.lerobot is None and words.hdf5 is None:
        parser.error("say where to: --lerobot FOLDER or --hdf5 FILE")
    recordings = [taxel.read(path) for path in words.recordings]
    if words.lerobot is not None:
        frames = write_lerobot(recordings, words.task, words.fps, words.lerobot)
        print(f"{words.lerobot}: {len(recordings)} episodes, {frames} frames at {words.fps} Hz")
    if words.hdf5 is not None:
        print(f"{words.hdf5}: {len(recordings)} episodes, {write_hdf5(recordings, words.hdf5)} rows")


if __name__ == "__main__":
    try:
        main()
    except (taxel.TaxelError, FileExistsError) as error:
        raise SystemExit(f"export_dataset: {error}") from None

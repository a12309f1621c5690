"""Shows a finger in Rerun, live or from a recording: pad, taxels, force arrow, plots, and flags as a log.

    python show_in_rerun.py usb
    python show_in_rerun.py tour.mcap
    python show_in_rerun.py sim:tour --seconds 5 --save tour.rrd

Needs ``pip install rerun-sdk``. A live finger is set to stream force, point and signals; a recording shows
the taxels if it was made with ``--fields all``. Lengths are in mm in the finger's frame, z into the skin; the
arrow ends at the contact, 10 mm for each newton. Times are the finger's own.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb

import taxel
from taxel import Fields, Finger, Status
from taxel.table import Columns

RECORDINGS = (".mcap", ".parquet", ".csv")
FIELDS = Fields.FORCE | Fields.POINT | Fields.SIGNALS
BATCH_S = 1 / 30
"""Device time between updates of a live viewer."""

PAD_MM = 10.0
DEPTH_MM = 2.0
"""Depth of the taxels under the skin, as it is drawn."""

TAXELS = [f"c_r{row}c{column}" for row in range(4) for column in range(4)]
PITCH_MM = 2.5
BRIGHT = 0.3
"""Signal of a taxel with the brightest colour."""

MM_PER_N = 10.0
DARK_BLUE, YELLOW = (26, 38, 115), (255, 217, 26)
GREEN, RED, GREY = (26, 191, 77), (230, 60, 60), (150, 150, 160)

FAULTS = Status.SATURATED | Status.DEAD_TAXEL | Status.BRIDGE_FAULT | Status.STUCK_CHANNEL | Status.SLIDES
WARNINGS = (
    Status.UNCALIBRATED
    | Status.OUT_OF_RANGE
    | Status.OVERRUN
    | Status.NOT_SINGLE
    | Status.DISAGREE
    | Status.SLIP_WARNING
    | Status.TEMPERATURE
    | Status.NOISY
    | Status.ROW_HELD
)


def blueprint() -> rrb.Blueprint:
    """Arranges the picture beside the plots, and the log below."""
    eye = rrb.EyeControls3D(position=(-12, -20, -17), look_target=(0, 0, -5), eye_up=(0, 0, -1))
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial3DView(
                    name="Finger (mm)",
                    contents=["pad", "taxels", "force", "place"],
                    eye_controls=eye,
                    line_grid=False,
                ),
                rrb.Vertical(
                    rrb.TimeSeriesView(name="Force (N)", contents=["force/fz_n", "force/shear_n"]),
                    rrb.TimeSeriesView(name="Contact point (mm)", contents=["place/x_mm", "place/y_mm"]),
                ),
            ),
            rrb.TextLogView(name="Flags", contents=["flags"]),
            row_shares=[3, 1],
        ),
        rrb.TimePanel(timeline="device_time", state="collapsed"),
        collapse_panels=True,
    )


def draw_pad() -> None:
    """Logs everything that stays: outline, places of the taxels, and styles of the plots."""
    pad = rr.Boxes3D(
        centers=[(0, 0, DEPTH_MM / 2)],
        half_sizes=[(PAD_MM / 2, PAD_MM / 2, DEPTH_MM / 2)],
        colors=[GREY],
        fill_mode=rr.components.FillMode.MajorWireframe,
    )
    rr.log("pad", pad, static=True)
    centres = [((k % 4 - 1.5) * PITCH_MM, (k // 4 - 1.5) * PITCH_MM, DEPTH_MM) for k in range(16)]
    plates = rr.Boxes3D(
        centers=centres,
        half_sizes=[(0.425 * PITCH_MM, 0.425 * PITCH_MM, 0.2)],
        fill_mode=rr.components.FillMode.Solid,
    )
    rr.log("taxels", plates, static=True)
    rr.log("force", rr.Arrows3D.from_fields(colors=[GREEN], radii=[0.3]), static=True)
    rr.log("place", rr.Points3D.from_fields(colors=[RED], radii=[0.4]), static=True)
    for name, colour in (
        ("force/fz_n", GREEN),
        ("force/shear_n", YELLOW),
        ("place/x_mm", RED),
        ("place/y_mm", GREEN),
    ):
        rr.log(name, rr.SeriesLines(colors=[colour], names=[name.partition("/")[2]]), static=True)


class Viewer:
    """Rerun's view of one finger, which grows by rows."""

    def __init__(self) -> None:
        self.status = 0
        self.quiet_until: dict[Status, int] = {}
        draw_pad()

    def show(self, columns: Columns) -> None:
        """Logs rows, named as in the CSV files; missing values and columns leave gaps."""
        times = columns["t_us"].astype("timedelta64[us]")
        if len(times) == 0:
            return
        absent = np.full(len(times), np.nan)
        force = np.stack([columns.get(name, absent) for name in ("fx_n", "fy_n", "fz_n")], axis=1)
        point = np.stack([columns.get(name, absent) for name in ("x_mm", "y_mm")], axis=1)
        for name, values in (
            ("force/fz_n", force[:, 2]),
            ("force/shear_n", np.hypot(force[:, 0], force[:, 1])),
            ("place/x_mm", point[:, 0]),
            ("place/y_mm", point[:, 1]),
        ):
            send(name, times, rr.Scalars.columns(scalars=values))
        # A row without a value draws nothing: it removes the arrow or the place of the row before.
        at = np.pad(point, ((0, 0), (0, 1)))
        placed = np.isfinite(point).all(axis=1)
        send("place", times, rr.Points3D.columns(positions=at[placed]).partition(placed.astype(int)))
        pushed = placed & np.isfinite(force).all(axis=1)
        vectors = MM_PER_N * force[pushed]
        arrows = rr.Arrows3D.columns(vectors=vectors, origins=at[pushed] - vectors)
        send("force", times, arrows.partition(pushed.astype(int)))
        if TAXELS[0] in columns:
            signals = np.stack([columns[name] for name in TAXELS], axis=1)
            known = np.isfinite(signals).all(axis=1)
            colours = rr.Boxes3D.columns(colors=colour(signals[known]).reshape(-1, 3))
            send("taxels", times[known], colours.partition([16] * int(known.sum())))
        self.log_flags(columns)

    def log_flags(self, columns: Columns) -> None:
        """Logs each fault or warning that begins; one that flickers, once a second."""
        status = columns["status"].astype(np.int64)
        began = status & ~np.concatenate([[self.status], status[:-1]])
        self.status = int(status[-1])
        times, texts, levels = [], [], []
        for row in np.flatnonzero(began & int(FAULTS | WARNINGS)):
            t_us = int(columns["t_us"][row])
            for flag in Status(int(began[row])) & (FAULTS | WARNINGS):
                if t_us >= self.quiet_until.get(flag, 0):
                    self.quiet_until[flag] = t_us + 1_000_000
                    times.append(np.timedelta64(t_us, "us"))
                    texts.append(str(flag.name).lower().replace("_", " "))
                    levels.append(rr.TextLogLevel.ERROR if flag in FAULTS else rr.TextLogLevel.WARN)
        if times:
            send("flags", np.array(times), rr.TextLog.columns(text=texts, level=levels))


def send(entity: str, times: npt.NDArray[Any], columns: rr.ComponentColumnList) -> None:
    rr.send_columns(entity, indexes=[rr.TimeColumn("device_time", duration=times)], columns=columns)


def colour(signals: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Returns colours from dark blue at rest to yellow."""
    share = np.clip(np.abs(signals) / BRIGHT, 0, 1)[..., np.newaxis]
    return np.asarray(DARK_BLUE + share * np.subtract(YELLOW, DARK_BLUE), dtype=np.uint8)


def batches(port: str, seconds: float | None) -> Iterator[Columns]:
    """Yields the stream of a finger as rows, some thirty times a second."""
    with Finger(port) as finger:
        finger.set_fields(FIELDS)
        frames: list[taxel.Frame] = []
        for frame in finger.frames(seconds):
            frames.append(frame)
            if frame.time_s - frames[0].time_s >= BATCH_S:
                yield taxel.columns(frames, FIELDS)
                frames = []
        if frames:
            yield taxel.columns(frames, FIELDS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", nargs="?", default="usb", help="a port, or a recording")
    parser.add_argument("--seconds", type=float, help="seconds of a live finger")
    rr.script_add_args(parser)
    words = parser.parse_args()
    if words.save and Path(words.save).exists():
        raise SystemExit(f"show_in_rerun: {words.save} exists; delete it, or give --save another name")
    recorded = Path(words.source).suffix in RECORDINGS
    sources = [taxel.read(words.source).columns] if recorded else batches(words.source, words.seconds)
    rr.script_setup(words, "taxel", default_blueprint=blueprint())
    viewer, rows = Viewer(), 0
    try:
        for columns in sources:
            viewer.show(columns)
            rows += len(columns["t_us"])
    except KeyboardInterrupt:
        pass
    print(f"{words.source}: {rows} frames")
    rr.script_teardown(words)


if __name__ == "__main__":
    try:
        main()
    except taxel.TaxelError as error:
        raise SystemExit(f"show_in_rerun: {error}") from None

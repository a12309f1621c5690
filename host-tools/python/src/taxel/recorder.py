"""Recorder of a finger's stream into a file that ``taxel`` reads."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from datetime import datetime, timezone
from math import isnan
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

from .clock import HostTime
from .errors import RecordingError
from .messages import Fields, Frame, PointMethod
from .table import columns

if TYPE_CHECKING:
    from .finger import Finger

_FLUSH_S = 0.25
_HOST = ("host_us", "host_scan_us", "host_scan_error_us", "connection")
_POINT = {PointMethod.CENTROID: "centroid", PointMethod.ARG_MIN: "argmin", PointMethod.MODEL: "model"}

Row = tuple[Frame, float, HostTime | None]


class Recorder:
    """Writes every received frame while it is open, whatever the program takes of them.

    A thread writes; rows reach the file within a second, so that a killed program loses no more.
    """

    def __init__(self, finger: Finger, path: str | Path, overwrite: bool = False) -> None:
        self.path = Path(path)
        if self.path.suffix != ".csv":
            raise RecordingError(
                f"{path}: expected a name that ends in .csv; `taxel export` makes MCAP or Parquet of it"
            )
        self.frames = 0
        """Frames written."""
        self._finger = finger
        self._unix = time.time() - time.monotonic()
        self._rows: list[Row] = []
        self._lock = threading.Lock()
        self._failed: OSError | None = None
        self._closing = threading.Event()
        self._fields = finger.info().fields
        facts = _facts(finger)
        try:
            self._file = self.path.open("w" if overwrite else "x", newline="")
        except FileExistsError as error:
            raise RecordingError(
                f"{path}: the file exists already; choose another name, or overwrite=True"
            ) from error
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror or error}") from error
        self._begin(self._file, facts)
        self._writer = threading.Thread(target=self._write, name="taxel-recorder", daemon=True)
        self._writer.start()
        finger._stream.listeners.append(self._take)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Writes what is left and closes the file; raises an error if the disk was full."""
        if self._closing.is_set():
            return
        self._finger._stream.listeners.remove(self._take)
        self._closing.set()
        self._writer.join()
        try:
            self._file.close()
        except OSError as error:
            self._failed = self._failed or error
        if self._failed is not None:
            reason = self._failed.strerror or self._failed
            raise RecordingError(f"{self.path}: {reason}; {self.frames} frames are written")

    def _take(self, frame: Frame, at: float, host: HostTime | None) -> None:
        with self._lock:
            self._rows.append((frame, at, host))

    def _begin(self, file: TextIO, facts: dict[str, str]) -> None:
        # A finger may send any text; a line break would begin a line that is no fact.
        printable = {k: re.sub(r"[^ -~]", "?", fact) for k, fact in sorted(facts.items())}
        file.writelines(f"# {name}={fact}\n" for name, fact in printable.items())
        file.write(",".join([*columns([], self._fields), *_HOST]) + "\n")
        file.flush()

    def _write(self) -> None:
        while True:
            last = self._closing.wait(_FLUSH_S)
            with self._lock:
                rows, self._rows = self._rows, []
            try:
                if self._failed is None:
                    self._file.writelines(self._lines(rows))
                    self._file.flush()
                    self.frames += len(rows)
            except OSError as error:
                self._failed = error
            if last:
                return

    def _lines(self, rows: list[Row]) -> Iterator[str]:
        table = columns([frame for frame, _, _ in rows], self._fields)
        cells = [map(_cell, column.tolist()) for column in table.values()]
        for (_, at, host), *row in zip(rows, *cells, strict=True):
            times = [round((at + self._unix) * 1e6)]
            if host is not None:
                times += [round(host.unix_s * 1e6), round(host.error_s * 1e6)]
            yield ",".join([*row, *map(str, times), *[""] * (3 - len(times)), "1"]) + "\n"


def _cell(value: float) -> str:
    # Nine digits read back as the same 32 bits.
    return f"{value}" if isinstance(value, int) else "" if isnan(value) else f"{value:.9g}"


def _facts(finger: Finger) -> dict[str, str]:
    """Returns the facts of a recording, named as by ``taxel record``."""
    info = finger.info()
    fields = [field.name.lower() for field in Fields if field in info.fields and field.name]
    facts = {
        "board": info.board,
        "serial": info.serial,
        "build": info.build,
        "firmware": ".".join(map(str, finger.version.firmware)),
        "port": finger.port,
        "full_scale": str(info.full_scale),
        "scan_hz": str(info.scan_hz),
        "rate_hz": f"{info.rate_millihertz / 1000:.9g}",
        "filter_hz": str(info.filter_hz),
        "fields": ",".join(fields),
        "point": _POINT[info.point_method],
        "biased": str(info.biased).lower(),
        "started": _date(time.time(), "milliseconds"),
    }
    if info.calibration is not None:
        facts["calibration_serial"] = info.calibration.serial
        facts["calibration_crc"] = f"{info.calibration.crc:08x}"
        facts["calibration_date"] = _date(info.calibration.date, "seconds")
    if info.biased:
        bias = finger.read_bias()
        parts = {"bias_matrix": bias.taxels} | {f"bias_s{i}": part for i, part in enumerate(bias.bridges)}
        for name, part in parts.items():
            if part is not None:
                facts[name] = " ".join(f"{value:.9g}" for value in (part.noise, *part.level))
    return facts


def _date(unix: float, precision: str) -> str:
    date = datetime.fromtimestamp(unix, timezone.utc).isoformat(timespec=precision)
    return date.replace("+00:00", "Z")

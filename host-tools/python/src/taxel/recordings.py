"""Recordings of ``taxel record`` and of :meth:`taxel.Finger.record` as arrays."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import RecordingError
from .table import Columns

if TYPE_CHECKING:
    import pandas

WITHHELD = "_withheld"
_WHOLE = ("t_us", "seq", "status")
"""Columns without a missing value, which are whole numbers; the others are floats."""


@dataclass(frozen=True)
class Recording:
    """Rows of a recording as arrays, with the facts of its finger."""

    columns: Columns
    """An array for each column: float64 (NaN: a missing value), but ``t_us``, ``seq``, ``status`` whole."""
    reasons: Columns = field(default_factory=dict)
    """Reasons for missing values by column, as text; empty where there is a value. CSV files have none."""
    facts: dict[str, str] = field(default_factory=dict)
    """The finger and its settings: ``serial``, ``rate_hz``, ``fields``, …"""
    calibration: str | None = None
    """The active calibration, as a file of ``taxel calibrate``; CSV files have none."""

    def __getitem__(self, column: str) -> np.ndarray[Any, np.dtype[Any]]:
        try:
            return self.columns[column]
        except KeyError:
            raise RecordingError(
                f"no column {column}: recorded are {self.facts.get('fields') or ', '.join(self.columns)}"
            ) from None

    def __len__(self) -> int:
        return len(self.columns["t_us"])

    @property
    def time_s(self) -> np.ndarray[Any, np.dtype[Any]]:
        """Device time in seconds."""
        return self["t_us"] * 1e-6

    def data_frame(self) -> pandas.DataFrame:
        """Returns the columns as a ``pandas.DataFrame``, indexed by device time in seconds."""
        import pandas

        return pandas.DataFrame(self.columns).set_index(self.time_s).rename_axis("t_s")


def read(path: str | Path) -> Recording:
    """Reads a recording: ``.mcap`` and ``.parquet`` need the extra ``recordings``, ``.csv`` needs nothing."""
    path = Path(path)
    readers = {".csv": _csv, ".mcap": _mcap, ".parquet": _parquet}
    reader = readers.get(path.suffix)
    if reader is None:
        raise RecordingError(f"{path}: unknown kind of recording; expected .mcap, .parquet or .csv")
    try:
        recording = reader(path)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror or error}") from error
    except ModuleNotFoundError as error:
        raise RecordingError(
            f"{path}: needs the package {error.name}; `pip install './host-tools/python[recordings]'`"
        ) from error
    if "t_us" not in recording.columns:
        raise RecordingError(f"{path}: the column t_us is missing; is it a recording of frames?")
    return recording


def _numbers(name: str, values: Any) -> np.ndarray[Any, np.dtype[Any]]:
    return np.asarray(values, dtype=np.uint64 if name in _WHOLE else np.float64)


def _csv(path: Path) -> Recording:
    facts: dict[str, str] = {}

    def rows() -> Iterator[tuple[int, str]]:
        with path.open(newline="") as file:
            for number, line in enumerate(file, 1):
                if line.startswith("#"):
                    name, _, value = line[1:].partition("=")
                    facts[name.strip()] = value.strip()
                else:
                    yield number, line

    names: list[str] = []
    cells: list[list[str]] = []
    for number, line in rows():
        row = next(csv.reader([line]))
        if not names:
            names = row
        elif len(row) == len(names):
            cells.append(row)
        else:
            raise RecordingError(f"{path}:{number}: {len(row)} columns, expected {len(names)}")
    columns: Columns = {}
    for name, column in zip(names, zip(*cells, strict=True) if cells else [()] * len(names), strict=True):
        try:
            if name in _WHOLE:
                columns[name] = _numbers(name, [int(cell) for cell in column])
            elif name.startswith("host_"):
                columns[name] = _numbers(name, [float(cell) if cell else nan for cell in column])
            else:
                # The digits are those of 32 bits, as the other formats hold them.
                single = np.array([float(cell) if cell else nan for cell in column], dtype=np.float32)
                columns[name] = _numbers(name, single)
        except ValueError as error:
            raise RecordingError(f"{path}: column {name}: {error}") from error
    return Recording(columns, {}, facts)


def _parquet(path: Path) -> Recording:
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(path)
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from error
    facts = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    calibration = facts.pop("calibration", None)
    columns, reasons = {}, {}
    for name in table.column_names:
        column = table[name]
        if name.endswith(WITHHELD):
            words = ["" if word is None else _words(word) for word in column.to_pylist()]
            reasons[name.removesuffix(WITHHELD)] = np.array(words, dtype=np.str_)
        else:
            columns[name] = _numbers(name, column.to_numpy())
    return Recording(columns, reasons, facts, calibration)


def _has_frames(path: Path) -> bool:
    """True if a damaged MCAP file lists chunks of frames, or has frames before the damage."""
    from mcap.reader import make_reader
    from mcap.records import Message
    from mcap.stream_reader import StreamReader

    # The errors of the decompressors have no class in common.
    with path.open("rb") as file:
        try:
            summary = make_reader(file).get_summary()
            if summary is not None and summary.chunk_indexes:
                return True
        except Exception:  # noqa: BLE001
            pass
        file.seek(0)
        try:
            return any(isinstance(record, Message) for record in StreamReader(file).records)
        except Exception:  # noqa: BLE001
            return False


def _mcap(path: Path) -> Recording:
    from mcap.exceptions import McapError
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    with path.open("rb") as file:
        try:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            messages = [
                message
                for schema, _, _, message in reader.iter_decoded_messages()
                if schema is not None and schema.name == "taxel.Frame"
            ]
            facts = next((each.metadata for each in reader.iter_metadata() if each.name == "taxel"), {})
            # Not of the finger: `taxel` finds by it which of two copies is damaged.
            facts.pop("facts_crc", None)
            calibration = next((each.data.decode() for each in reader.iter_attachments()), None)
        except McapError as error:
            mend = "no frame of it can be read: record again"
            if _has_frames(path):
                mend = f"`taxel export {path.name} --out saved.mcap` saves what can be read"
            raise RecordingError(f"{path}: damaged or cut off ({error}); {mend}") from error
    columns: Columns = {}
    reasons: Columns = {}
    for field_of in messages[0].DESCRIPTOR.fields if messages else ():
        name = field_of.name
        if name.endswith(WITHHELD):
            words = {value.number: _words(value.name) for value in field_of.enum_type.values} | {0: ""}
            column = [words[getattr(message, name)] for message in messages]
            reasons[name.removesuffix(WITHHELD)] = np.array(column, dtype=np.str_)
        else:
            given = [getattr(each, name) if each.HasField(name) else nan for each in messages]
            columns[name] = _numbers(name, given)
    return Recording(columns, reasons, dict(facts), calibration)


def _words(reason: str) -> str:
    """Formats a reason in the words of :class:`taxel.NoValue`: ``no contact``, ``ill conditioned``."""
    return reason.lower().replace("_", " ").replace("-", " ")

"""Tests of `taxel record`'s files with other projects' libraries: MCAP's own, pyarrow and pandas."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory

SECONDS = 2
FILES = ("a.mcap", "a.parquet", "a.csv")


@pytest.fixture(scope="module")
def folder(command: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    record = [command, "record", "--port", "sim:press", "--fields", "all"]
    files = [word for name in FILES for word in ("--out", name)]
    subprocess.run([*record, "--duration", str(SECONDS), *files], cwd=folder, check=True)
    return folder


@pytest.fixture(scope="module")
def table(folder: Path) -> pd.DataFrame:
    return pd.read_parquet(folder / "a.parquet")


def test_mcap_is_whole_and_describes_itself(folder: Path):
    with (folder / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == SECONDS * 1000
        (channel,) = summary.channels.values()
        assert (channel.topic, channel.message_encoding) == ("/taxel/press", "protobuf")
        (schema,) = summary.schemas.values()
        assert (schema.name, schema.encoding) == ("taxel.Frame", "protobuf")
        # Both ends of the file hold them, so that one damaged place loses neither.
        attachment, again = reader.iter_attachments()
        assert attachment.name == "calibration.toml" and b"taxel_calibration" in attachment.data
        assert again.data == attachment.data
        metadata, repeated = reader.iter_metadata()
        assert metadata.metadata["board"] == "virtual" and repeated == metadata


def test_recording_compressed_again_by_other_tools_is_read(folder: Path, command: str):
    for compression in CompressionType:
        name = f"{compression.name}.mcap"
        with (folder / "a.mcap").open("rb") as source, (folder / name).open("wb") as file:
            reader, writer = make_reader(source), Writer(file, compression=compression)
            writer.start()
            for metadata in reader.iter_metadata():
                writer.add_metadata(metadata.name, metadata.metadata)
            for attachment in reader.iter_attachments():
                a = attachment
                writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
            channel_id = None
            for schema, channel, message in reader.iter_messages():
                assert schema is not None
                if channel_id is None:
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channel_id = writer.register_channel(channel.topic, "protobuf", schema_id)
                writer.add_message(channel_id, message.log_time, message.data, message.publish_time)
            writer.finish()
        export = [command, "export", name, "--out", f"{compression.name}.csv"]
        subprocess.run(export, cwd=folder, check=True)
        again = (folder / f"{compression.name}.csv").read_text()
        assert again == (folder / "a.csv").read_text(), compression


def test_mcap_and_parquet_hold_the_same_cells(folder: Path, table: pd.DataFrame):
    with (folder / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = [decoded for _, _, _, decoded in reader.iter_decoded_messages()]
    assert len(messages) == len(table) == SECONDS * 1000
    fields = [f.name for f in messages[0].DESCRIPTOR.fields]
    assert fields == list(table.columns)
    withheld = 0
    for name in fields:
        theirs = [getattr(m, name) if m.HasField(name) else None for m in messages]
        column = table[name]
        if name.endswith("_withheld"):
            names = messages[0].DESCRIPTOR.fields_by_name[name].enum_type.values_by_number
            words = [None if v is None else names[v].name.lower() for v in theirs]
            ours = [None if pd.isna(v) else v.replace(" ", "_").replace("-", "_") for v in column]
            assert words == ours, name
            withheld += sum(word is not None for word in words)
        else:
            numbers = np.array([np.nan if v is None else v for v in theirs], dtype=np.float64)
            np.testing.assert_array_equal(numbers, column.astype(np.float64), err_msg=name)
    assert withheld > 0 and table["fz_n"].max() > 0.5


def test_csv_holds_the_values_of_parquet(folder: Path, table: pd.DataFrame):
    csv = pd.read_csv(folder / "a.csv", comment="#")
    for name in csv.columns:
        theirs = csv[name].astype(np.float32 if table[name].dtype == np.float32 else np.float64)
        np.testing.assert_array_equal(theirs, table[name].astype(theirs.dtype), err_msg=name)
    assert set(csv.columns) == {name for name in table.columns if not name.endswith("_withheld")}


def test_parquet_names_the_finger_and_carries_its_calibration(folder: Path):
    facts: dict[bytes, Any] = pq.read_schema(folder / "a.parquet").metadata
    assert facts[b"serial"] == b"press" and facts[b"rate_hz"] == b"1000"
    assert any(b"taxel_calibration" in value for value in facts.values())


def test_rows_have_host_time_and_mapped_scan_time(table: pd.DataFrame):
    mapped = table.dropna(subset="host_scan_us")
    assert len(mapped) > len(table) * 0.3
    # A scan precedes its frame, and its steps follow the finger's clock, within what each states.
    late = mapped["host_us"].astype(float) - mapped["host_scan_us"].astype(float)
    assert late.median() > 0 and late.min() > -1000
    errors = mapped["host_scan_error_us"].astype(float).to_numpy()
    assert errors.min() > 0
    assert (table["host_scan_error_us"].notna() == table["host_scan_us"].notna()).all()
    steps = np.diff(mapped["host_scan_us"].astype(float)) - np.diff(mapped["t_us"].astype(float))
    # Times are whole microseconds.
    assert (np.abs(steps) <= errors[:-1] + errors[1:] + 2).all() and np.median(np.abs(steps)) <= 1
    assert set(table["connection"]) == {1}

"""Tests of `taxel record`'s files with other projects' libraries: MCAP's own, pyarrow and pandas."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from fingers import rows
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import DescriptorProto
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory

SECONDS = 2
FILES = ("a.mcap", "a.parquet", "a.csv")
FRAMES = "/taxel/press"


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
        schemas = {}
        for id_, channel in summary.channels.items():
            schema = summary.schemas[channel.schema_id]
            assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf")
            schemas[channel.topic] = schema.name
            if channel.topic == FRAMES:
                assert summary.statistics.channel_message_counts[id_] == SECONDS * 1000
        assert schemas == {
            FRAMES: "taxel.Frame",
            f"{FRAMES}/scene": "foxglove.SceneUpdate",
            f"{FRAMES}/log": "foxglove.Log",
            f"{FRAMES}/contact": "foxglove.PoseInFrame",
            f"{FRAMES}/tf": "foxglove.FrameTransform",
        }
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
            ids: dict[str, int] = {}
            for schema, channel, message in reader.iter_messages():
                assert schema is not None
                if channel.topic not in ids:
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                    ids[channel.topic] = writer.register_channel(channel.topic, "protobuf", schema_id)
                writer.add_message(ids[channel.topic], message.log_time, message.data, message.publish_time)
            writer.finish()
        export = [command, "export", name, "--out", f"{compression.name}.csv"]
        subprocess.run(export, cwd=folder, check=True)
        again = (folder / f"{compression.name}.csv").read_text()
        assert again == (folder / "a.csv").read_text(), compression


def test_mcap_and_parquet_hold_the_same_cells(folder: Path, table: pd.DataFrame):
    with (folder / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = [decoded for _, _, _, decoded in reader.iter_decoded_messages(topics=[FRAMES])]
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


def official(descriptor: Any, theirs: Any) -> int:
    """Compares a message's schema and those of its parts with Foxglove's own; counts the fields."""
    compared = 0
    for field in descriptor.fields:
        kinds = []
        for message in (descriptor, theirs):
            whole = DescriptorProto()
            message.CopyToProto(whole)
            (kind,) = [f for f in whole.field if f.name == field.name]
            kinds.append((kind.number, kind.type, kind.label, kind.type_name))
        assert kinds[0] == kinds[1], f"{descriptor.full_name}.{field.name}"
        compared += 1
        other = theirs.fields_by_name[field.name]
        if field.enum_type is not None:
            values = [{v.name: v.number for v in f.enum_type.values} for f in (field, other)]
            assert values[0] == values[1]
        if field.message_type is not None:
            compared += official(field.message_type, other.message_type)
    return compared


def test_mcap_has_scene_log_and_contact_in_foxglove_schemas(command: str, tmp_path: Path):
    """Foxglove's own classes read what was recorded, and what was exported from a table."""
    record = [command, "record", "--port", "sim:fault", "--fields", "all", "--duration", "3"]
    files = ["--out", "a.mcap", "--out", "a.parquet", "--out", "a.csv"]
    subprocess.run([*record, *files], cwd=tmp_path, check=True)
    subprocess.run([command, "export", "a.parquet", "--out", "b.mcap"], cwd=tmp_path, check=True)
    # The first of frames that came together is drawn.
    by_time: dict[int, dict[str, str]] = {}
    for row in rows(tmp_path / "a.csv"):
        by_time.setdefault(int(row["host_us"]), row)
    for name in ("a.mcap", "b.mcap"):
        scenes, logs, arrows, fields, places = [], [], 0, set(), set()
        with (tmp_path / name).open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for _, channel, message, decoded in reader.iter_decoded_messages():
                end = channel.topic.removeprefix("/taxel/fault")
                if end == "/log":
                    logs.append(Log.FromString(message.data))
                    fields.add(official(decoded.DESCRIPTOR, Log.DESCRIPTOR))
                if end in ("/contact", "/tf"):
                    row = by_time[message.log_time // 1000]
                    place = (float(row["x_mm"]), float(row["y_mm"]), 0.0)
                    if end == "/contact":
                        contact = PoseInFrame.FromString(message.data)
                        found, frame = contact.pose.position, contact.frame_id
                        fields.add(official(decoded.DESCRIPTOR, PoseInFrame.DESCRIPTOR))
                    else:
                        tf = FrameTransform.FromString(message.data)
                        found, frame = tf.translation, tf.parent_frame_id
                        assert (tf.child_frame_id, tf.rotation.w) == ("fault_contact", 1)
                        fields.add(official(decoded.DESCRIPTOR, FrameTransform.DESCRIPTOR))
                    assert np.allclose((found.x, found.y, found.z), 1e-3 * np.array(place), atol=1e-9)
                    assert frame == "fault"
                    places.add(end)
                if end != "/scene":
                    continue
                scenes.append(message.log_time)
                fields.add(official(decoded.DESCRIPTOR, SceneUpdate.DESCRIPTOR))
                (entity,) = SceneUpdate.FromString(message.data).entities
                assert entity.timestamp.ToNanoseconds() == message.log_time
                assert (entity.frame_id, entity.id, len(entity.cubes)) == ("fault", "finger", 17)
                row = by_time[message.log_time // 1000]
                assert len(entity.arrows) == bool(row["x_mm"] and row["fz_n"])
                for arrow in entity.arrows:
                    force = np.array([float(row[axis]) for axis in ("fx_n", "fy_n", "fz_n")])
                    length = arrow.shaft_length + arrow.head_length
                    assert np.isclose(length, 0.01 * np.linalg.norm(force), rtol=1e-4)
                    arrows += 1
        # 60 scenes a second, from frames a millisecond apart.
        steps = np.diff(scenes)
        assert 150 < len(scenes) < 190 and steps.min() >= 16_666_000, (len(scenes), steps.min())
        assert arrows > 10 and len(fields) >= 3 and min(fields) >= 6 and len(places) == 2
        faults = [line for line in logs if line.message.startswith("dead-taxel: ")]
        assert faults and all(line.level == Log.Level.ERROR for line in faults)

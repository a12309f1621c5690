"""Tests of `taxel bridge --foxglove` with an independent client of the Foxglove WebSocket protocol.

The client follows the specification `foxglove.sdk.v1`. Foxglove's own classes read scene and log, and check
the layout.
"""

import base64
import json
import re
import signal
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints
from xml.etree import ElementTree

import numpy as np
from fingers import CALIBRATION, ROOT, replayed, rows
from foxglove import layouts
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from test_recordings import official
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

MESSAGE = struct.Struct("<BIQ")
MESSAGE_DATA = 1


@contextmanager
def bridge(command: str, ports: list[str], *more: str) -> Iterator[tuple[Any, str]]:
    """Starts the bridge; yields its process and address."""
    fingers = [word for port in ports for word in ("--port", port)]
    process = subprocess.Popen(
        [command, "bridge", "--foxglove", "127.0.0.1:0", *fingers, *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        while "ws://" not in line:
            assert line, "it ended before it served"
            line = process.stderr.readline()
        yield process, line.split()[-1]
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.wait(20)


def open_viewer(url: str) -> ClientConnection:
    return connect(url, subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None)


def channels(viewer: ClientConnection, topics: set[str]) -> dict[str, Any]:
    """Waits for all these topics; returns the advertised channels."""
    offered: dict[str, Any] = {}
    while not topics <= offered.keys():
        word = viewer.recv(timeout=30)
        if isinstance(word, str) and json.loads(word)["op"] == "advertise":
            offered |= {channel["topic"]: channel for channel in json.loads(word)["channels"]}
    return offered


def message_class(channel: dict[str, Any]) -> Any:
    schema = base64.b64decode(channel["schema"])
    files = descriptor_pb2.FileDescriptorSet.FromString(schema).file
    pool = descriptor_pool.DescriptorPool()
    for file in files:
        pool.Add(file)
    found = pool.FindMessageTypeByName(channel["schemaName"])
    return message_factory.GetMessageClass(found)


def subscribe(viewer: ClientConnection, ids: dict[int, int]) -> None:
    subscriptions = [{"id": of, "channelId": channel} for of, channel in ids.items()]
    viewer.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))


def messages(viewer: ClientConnection, ids: dict[int, int]) -> Iterator[tuple[int, int, bytes]]:
    """Yields subscription, time and bytes of each message on the channels with these ids."""
    subscribe(viewer, ids)
    while True:
        word = viewer.recv(timeout=30)
        if isinstance(word, str) and "Unknown channel ID" in word:
            # Foxglove's server advertises a channel a moment before it accepts subscriptions.
            subscribe(viewer, {of: id for of, id in ids.items() if f": {id}" in word})
        if isinstance(word, bytes) and word[0] == MESSAGE_DATA:
            _, of, nanos = MESSAGE.unpack_from(word)
            yield of, nanos, word[MESSAGE.size :]


def test_viewer_gets_values_and_reasons(command: str, tmp_path: Path):
    trace, expected = replayed(command, "presses", tmp_path)
    more = ["--calibration", str(CALIBRATION), "--fields", "all"]
    with bridge(command, [f"file:{trace}"], *more) as (_, url), open_viewer(url) as viewer:
        channel = channels(viewer, {"/taxel/trace"})["/taxel/trace"]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
        frame = message_class(channel)
        forces = withheld = 0
        last = 0
        for of, nanos, payload in messages(viewer, {7: channel["id"]}):
            message = frame.FromString(payload)
            row = expected[message.t_us]
            assert of == 7 and nanos == message.host_us * 1000 >= last
            last = nanos
            assert message.status == int(row["status"])
            for name in ("fx_n", "fy_n", "fz_n", "x_mm", "y_mm"):
                if row[name]:
                    assert message.HasField(name)
                    assert np.float32(row[name]) == np.float32(getattr(message, name)), name
                    forces += 1
                else:
                    assert not message.HasField(name)
                    assert getattr(message, f"{name}_withheld") > 0
                    withheld += 1
            if forces > 1000 and withheld > 100:
                return


def test_fingers_are_topics_and_used_address_is_an_error(command: str):
    with bridge(command, ["sim:press", "sim:shear"]) as (process, url):
        with open_viewer(url) as viewer:
            offered = channels(viewer, {"/taxel/press", "/taxel/shear"})
            ids = {k: channel["id"] for k, channel in enumerate(offered.values())}
            heard = set()
            for of, _, _ in messages(viewer, ids):
                heard.add(of)
                if len(heard) == 2:
                    break
        address = url.removeprefix("ws://")
        second = [command, "bridge", "--foxglove", address, "--port", "sim:press"]
        refused = subprocess.run(second, capture_output=True, text=True, timeout=60)
        assert refused.returncode == 1
        (line,) = refused.stderr.splitlines()
        assert "--foxglove HOST:PORT names another address" in line
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0


def test_scene_draws_pad_taxels_and_force(command: str, tmp_path: Path):
    trace, expected = replayed(command, "presses", tmp_path)
    # The bridge asks for the signals itself.
    with (
        bridge(command, [f"file:{trace}"], "--calibration", str(CALIBRATION)) as (_, url),
        open_viewer(url) as viewer,
    ):
        wanted = {"/taxel/trace", "/taxel/trace/scene", "/taxel/trace/contact", "/taxel/trace/tf"}
        offered = channels(viewer, wanted)
        channel, frames = offered["/taxel/trace/scene"], offered["/taxel/trace"]
        contact, tf = offered["/taxel/trace/contact"], offered["/taxel/trace/tf"]
        assert official(message_class(contact).DESCRIPTOR, PoseInFrame.DESCRIPTOR) >= 6
        assert official(message_class(tf).DESCRIPTOR, FrameTransform.DESCRIPTOR) >= 6
        assert (channel["encoding"], channel["schemaName"]) == ("protobuf", "foxglove.SceneUpdate")
        assert official(message_class(channel).DESCRIPTOR, SceneUpdate.DESCRIPTOR) >= 6
        frame = message_class(frames)
        by_time, arrows, bare, last, posed, framed = {}, 0, 0, None, 0, 0
        ids = {1: channel["id"], 2: frames["id"], 3: contact["id"], 4: tf["id"]}
        for of, nanos, payload in messages(viewer, ids):
            if of == 2:
                by_time[nanos] = frame.FromString(payload)
                continue
            if of == 3:
                pose = PoseInFrame.FromString(payload)
                assert (pose.frame_id, pose.timestamp.ToNanoseconds()) == ("trace", nanos)
                if nanos in by_time:
                    place = 1e-3 * np.array([by_time[nanos].x_mm, by_time[nanos].y_mm, 0])
                    at = pose.pose.position
                    assert np.allclose([at.x, at.y, at.z], place, atol=1e-9)
                    # The scene of the same frame came before it.
                    if last is not None:
                        assert pose.pose.orientation == last.pose.orientation
                    posed += 1
                continue
            if of == 4:
                transform = FrameTransform.FromString(payload)
                names = (transform.parent_frame_id, transform.child_frame_id)
                assert names == ("trace", "trace_contact")
                framed += 1
                continue
            last = None
            (entity,) = SceneUpdate.FromString(payload).entities
            assert (entity.frame_id, entity.id) == ("trace", "finger")
            assert entity.timestamp.ToNanoseconds() == nanos
            pad, *taxels = entity.cubes
            assert (pad.size.x, pad.size.y, len(taxels)) == (0.01, 0.01, 16)
            places = {(round(1e5 * t.pose.position.x), round(1e5 * t.pose.position.y)) for t in taxels}
            assert places == {(x, y) for x in (-375, -125, 125, 375) for y in (-375, -125, 125, 375)}
            if nanos not in by_time:
                continue
            row = expected[by_time[nanos].t_us]
            if not row["x_mm"] or not row["fz_n"]:
                assert not entity.arrows
                bare += 1
                continue
            (arrow,) = entity.arrows
            last = arrow
            force = np.array([float(row[name]) for name in ("fx_n", "fy_n", "fz_n")])
            length = arrow.shaft_length + arrow.head_length
            assert np.isclose(length, 0.01 * np.linalg.norm(force), rtol=1e-4)
            # The arrow's x axis, turned by its orientation, leads from its tail to the contact.
            q = arrow.pose.orientation
            x, y, z, w = q.x, q.y, q.z, q.w
            along = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
            tail = np.array([arrow.pose.position.x, arrow.pose.position.y, arrow.pose.position.z])
            tip = 1e-3 * np.array([float(row["x_mm"]), float(row["y_mm"]), 0])
            assert np.allclose(tail + length * np.array(along), tip, atol=1e-6)
            arrows += 1
            if arrows > 30 and bare > 5:
                assert posed >= arrows - 1 and framed >= arrows - 1
                return


def test_flags_are_lines_of_the_log(command: str):
    with bridge(command, ["sim:fault"]) as (_, url), open_viewer(url) as viewer:
        channel = channels(viewer, {"/taxel/fault/log"})["/taxel/fault/log"]
        assert channel["schemaName"] == "foxglove.Log"
        assert official(message_class(channel).DESCRIPTOR, Log.DESCRIPTOR) >= 4
        for _, nanos, payload in messages(viewer, {1: channel["id"]}):
            line = Log.FromString(payload)
            assert (line.name, line.timestamp.ToNanoseconds()) == ("fault", nanos)
            if line.message.startswith("dead-taxel: "):
                assert line.level == Log.Level.ERROR and "taxel self-test" in line.message
                return


def departures(value: Any, kind: Any, where: str) -> list[str]:
    """Lists what of a JSON value a type of Foxglove's layouts does not have, by its path."""
    origin, of = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return min((departures(value, each, where) for each in of), key=len)
    if origin is Literal:
        return [] if value in of else [where]
    if origin is list and isinstance(value, list):
        return [lack for k, each in enumerate(value) for lack in departures(each, of[0], f"{where}[{k}]")]
    if origin is dict and isinstance(value, dict):
        return [lack for key in value for lack in departures(value[key], of[1], f"{where}.{key}")]
    if origin is tuple and isinstance(value, list) and len(value) == len(of):
        return [lack for k, each in enumerate(of) for lack in departures(value[k], each, f"{where}[{k}]")]
    if is_dataclass(kind) and isinstance(value, dict):
        hints = get_type_hints(kind)
        names = {key: re.sub("[A-Z]", lambda capital: f"_{capital[0].lower()}", key) for key in value}
        return [
            lack
            for key, name in names.items()
            for lack in (
                departures(value[key], hints[name], f"{where}.{key}") if name in hints else [f"{where}.{key}"]
            )
        ]
    fits = kind is Any or isinstance(value, (int, float) if kind is float else kind if origin is None else ())
    return [] if fits else [where]


def test_layout_has_the_settings_of_foxgloves_own_package():
    """Names and types of all settings are those of `foxglove.layouts`, which makes layouts in Python."""
    layout = json.loads((ROOT / "host-tools/cli/layouts/foxglove.json").read_text())
    kinds = {"3D": layouts.ThreeDeeConfig, "Log": layouts.LogConfig, "Plot": layouts.PlotConfig}
    lacking = []
    for name, panel in layout["configById"].items():
        # In a layout file, a panel's title is beside its settings.
        settings = {key: value for key, value in panel.items() if key != "foxglovePanelTitle"}
        lacking += departures(settings, kinds[name.split("!")[0]], name)
    assert lacking == []
    wrong = {"paths": [{"value": 3}], "legendDisplay": "under", "showXaxis": True}
    assert departures(wrong, layouts.PlotConfig, "Plot") == [
        "Plot.paths[0].value",
        "Plot.legendDisplay",
        "Plot.showXaxis",
    ]


def test_layouts_show_what_is_published(command: str, tmp_path: Path):
    """Every topic and every plotted value of the layouts exists, with the schema its panel draws."""
    layout = json.loads((ROOT / "host-tools/cli/layouts/foxglove.json").read_text())
    panels = layout["configById"]

    def leaves(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
        else:
            yield from leaves(node["first"])
            yield from leaves(node["second"])

    assert set(leaves(layout["layout"])) == panels.keys()
    wanted = {"/taxel/tour", "/taxel/tour/scene", "/taxel/tour/log"}
    with bridge(command, ["sim:tour"]) as (_, url), open_viewer(url) as viewer:
        offered = channels(viewer, wanted)
    fields = message_class(offered["/taxel/tour"]).DESCRIPTOR.fields_by_name
    plotted = 0
    for name, panel in panels.items():
        match name.split("!")[0]:
            case "3D":
                (topic,) = panel["topics"]
                assert offered[topic]["schemaName"] == "foxglove.SceneUpdate"
            case "Log":
                assert offered[panel["topicToRender"]]["schemaName"] == "foxglove.Log"
            case "Plot":
                for path in panel["paths"]:
                    topic, _, value = path["value"].rpartition(".")
                    assert topic == "/taxel/tour" and value in fields, path
                    plotted += 1
            case other:
                raise AssertionError(other)
    assert plotted > 5
    recorded = tmp_path / "tour.csv"
    record = [command, "record", "--port", "sim:tour", "--duration", "0.2", "--out", str(recorded)]
    subprocess.run(record, check=True, capture_output=True)
    columns = next(rows(recorded)).keys()
    juggler = ElementTree.parse(ROOT / "host-tools/cli/layouts/plotjuggler.xml")
    curves = {curve.get("name") for curve in juggler.iter("curve")}
    assert len(curves) > 5 and curves <= columns

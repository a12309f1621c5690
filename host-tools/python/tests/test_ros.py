"""Tests of the messages and services of `taxel bridge --zenoh` beside wrench and frame.

Decoded by another project's CDR decoder, with the definitions of ROS 2 Jazzy.
"""

import json
import signal
import subprocess
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bridges import Network, at, bridge, listen, true_wrench, wait, wrench_of
from fingers import CALIBRATION, ROOT, replayed, rows, serve
from rosservices import Services
from ruamel.yaml import YAML

POINT = "geometry_msgs/msg/PointStamped"
MARKER = "visualization_msgs/msg/Marker"
TF = "tf2_msgs/msg/TFMessage"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
TRIGGER = "std_srvs/srv/Trigger"
ARROW, ADD, DELETE = 0, 0, 2
OK, WARN, ERROR = 0, 1, 2
# Flags that tell about the contact, not about the finger.
OF_THE_CONTACT = {"contact", "not-single", "slip-warning", "slides"}

REST = """
effects = ["noise"]

[scan]
rate_hz = 1000
duration_s = 5
"""


@pytest.fixture(scope="module")
def rest(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Port of a finger that nothing touches."""
    scene = tmp_path_factory.mktemp("scenes") / "rest.toml"
    scene.write_text(REST)
    return f"sim:{scene}"


def read(network: Network, topic: str, kind: str) -> list[Any]:
    return [network.store.deserialize_cdr(s.payload, kind) for s in network.samples(topic, kind)]


def vector(v: Any) -> np.ndarray[Any, Any]:
    return np.array([v.x, v.y, v.z])


def has_point(frame: Any) -> bool:
    return bool(frame.point) and frame.point[0].withheld == 0


def place_of(frame: Any) -> list[float]:
    return [value.value for value in frame.point]


def axes(roll: float, pitch: float, yaw: float) -> np.ndarray[Any, Any]:
    """Returns the rotation matrix of turns in degrees about the fixed axes x, y and z."""
    (sr, sp, sy), (cr, cp, cy) = (f(np.radians([roll, pitch, yaw])) for f in (np.sin, np.cos))
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


def rotated(q: Any, v: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Returns a vector turned by a quaternion."""
    u = np.array([q.x, q.y, q.z])
    turned: np.ndarray[Any, Any] = v + 2 * np.cross(u, np.cross(u, v) + q.w * v)
    return turned


def test_point_marker_and_transform_show_the_contact(command: str, network: Network, tmp_path: Path):
    trace, _ = replayed(command, "press", tmp_path)
    for topic, kind in (
        ("taxel/frames", listen.FRAME),
        ("taxel/trace/contact_point", POINT),
        ("taxel/trace/marker", MARKER),
        ("tf", TF),
    ):
        network.subscribe(topic, kind)
    with bridge(command, network, [f"file:{trace}"], "--calibration", str(CALIBRATION)) as process:
        process.communicate(timeout=60)
    frames = read(network, "taxel/frames", listen.FRAME)
    points = read(network, "taxel/trace/contact_point", POINT)
    # Nothing is heard before both topics are found.
    began = max(at(points[0]), at(frames[0])) + 1
    touched = [frame for frame in frames if at(frame) >= began and has_point(frame)]
    points = [point for point in points if at(point) >= began]
    assert len(points) == len(touched) > 500
    for point, frame in zip(points, touched, strict=True):
        assert (point.header, point.point.z) == (frame.header, 0.0)
        assert (point.point.x, point.point.y) == pytest.approx(place_of(frame), rel=1e-5)

    def those_of(message: Any) -> list[Any]:
        """Returns the frames with a message's timestamp: several if they were received together."""
        return [frame for frame in frames if at(frame) == at(message)]

    markers = [m for m in read(network, "taxel/trace/marker", MARKER) if at(m) >= began]
    arrows = [marker for marker in markers if marker.action == ADD]
    assert len(arrows) > 20
    for marker in arrows:
        assert (marker.type, marker.ns, marker.pose.orientation.w) == (ARROW, "trace", 1.0)
        tail, tip = (vector(end) for end in marker.points)
        assert any(
            tip == pytest.approx([*place_of(frame), 0], rel=1e-5)
            and tip - tail == pytest.approx([0.01 * part.value for part in frame.force], abs=1e-8)
            for frame in those_of(marker)
            if has_point(frame)
        )
    # An arrow disappears with its contact, once.
    ends = [marker for marker in markers if marker.action == DELETE]
    assert 1 <= len(ends) < len(arrows)
    assert all(not all(map(has_point, those_of(marker))) for marker in ends)
    transforms = [t for message in read(network, "tf", TF) for t in message.transforms]
    transforms = [transform for transform in transforms if at(transform) >= began]
    assert len(transforms) > 20
    for transform in transforms:
        assert (transform.header.frame_id, transform.child_frame_id) == ("trace", "trace_contact")
        place = vector(transform.transform.translation)
        assert any(
            place == pytest.approx([*place_of(frame), 0], rel=1e-5)
            for frame in those_of(transform)
            if has_point(frame)
        )
        assert transform.transform.rotation.w == 1.0


def test_rviz_configuration_shows_what_is_published(command: str, network: Network):
    """Each display's topic is published with the type that RViz's display takes, in the fixed frame."""
    config = YAML(typ="safe").load(ROOT / "host-tools/cli/layouts/finger.rviz")["Visualization Manager"]
    takes = {"Marker": MARKER, "PointStamped": POINT, "Wrench": listen.WRENCH}
    wanted = {"tf": TF}  # The display of frames names no topic.
    kinds = []
    for display in config["Displays"]:
        package, _, kind = display["Class"].partition("/")
        assert (package, display["Enabled"]) == ("rviz_default_plugins", True)
        kinds.append(kind)
        if "Topic" in display:
            wanted[display["Topic"]["Value"].removeprefix("/")] = takes[kind]
    assert sorted(kinds) == ["Grid", "Marker", "PointStamped", "TF", "Wrench"] and len(wanted) == 4
    for topic, kind in wanted.items():
        network.subscribe(topic, kind)
    with bridge(command, network, ["sim:tour"]):
        wait(lambda: all(network.samples(topic, kind) for topic, kind in wanted.items()))
    frame = config["Global Options"]["Fixed Frame"]
    for topic, kind in wanted.items():
        message = read(network, topic, kind)[0]
        header = message.transforms[0].header if kind == TF else message.header
        assert header.frame_id == frame == config["Views"]["Current"]["Target Frame"], topic


@pytest.mark.parametrize(
    ("scene", "fields"), [("tour", ["--fields", "all"]), ("torsion", [])], ids=["all", "default"]
)
def test_wrench_in_a_tilted_tool_frame_is_true(
    command: str, network: Network, tmp_path: Path, scene: str, fields: list[str]
):
    trace, _ = replayed(command, scene, tmp_path)
    for topic, kind in (
        ("taxel/frames", listen.FRAME),
        ("taxel/trace/wrench", listen.WRENCH),
        ("tf", TF),
    ):
        network.subscribe(topic, kind)
    origin, turns = np.array([5.0, -10.0, 20.0]), (40.0, -25.0, 110.0)
    pose = ",".join(map(str, (*origin, *turns)))
    more = ["--calibration", str(CALIBRATION), *fields, "--tool", pose]
    with bridge(command, network, [f"file:{trace}"], *more) as process:
        process.communicate(timeout=60)
    truth = {int(row["t_us"]): row for row in rows(trace) if row["x_mm"]}
    frames = read(network, "taxel/frames", listen.FRAME)
    wrenches = read(network, "taxel/trace/wrench", listen.WRENCH)
    assert {wrench.header.frame_id for wrench in wrenches} == {"trace_tool"}
    # Until the finger's clock is known, frames that are received together share a timestamp.
    count = Counter(map(at, frames))
    times = {at(frame): frame.device_us for frame in frames if count[at(frame)] == 1}
    errors = []
    for stamped in wrenches:
        row = truth.get(times.get(at(stamped), -1))
        if row is not None:
            force, torque = true_wrench(row)
            back = axes(*turns).T
            there = back @ force, back @ (torque - np.cross(1e-3 * origin, force))
            errors.append([a - b for a, b in zip(wrench_of(stamped), there, strict=True)])
    off = np.abs(np.array(errors))
    assert len(off) > 1000
    print(f"{len(off)} wrenches, torque off by {1e6 * off[:, 1].max():.0f} uN m at most")
    assert off[:, 1].max() < 0.3e-3, "N m"
    # The transform on /tf is that of the option: tf2 turns a vector of the tool as it does.
    tools = [t for m in read(network, "tf", TF) for t in m.transforms if t.child_frame_id == "trace_tool"]
    assert tools and all(tool.header.frame_id == "trace" for tool in tools)
    for axis in np.eye(3):
        expected = axes(*turns) @ axis
        assert rotated(tools[0].transform.rotation, axis) == pytest.approx(expected, abs=1e-9)
    assert vector(tools[0].transform.translation) == pytest.approx(1e-3 * origin)


def test_wrench_is_withheld_when_torsion_is_not_streamed(command: str, network: Network):
    network.subscribe("taxel/frames", listen.FRAME)
    network.subscribe("taxel/torsion/wrench", listen.WRENCH)
    with bridge(command, network, ["sim:torsion"], "--fields", "force,point", "--json") as process:
        wait(lambda: len(network.samples("taxel/frames", listen.FRAME)) > 500)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    (report,) = json.loads(out)
    assert report["withheld"] == report["frames"]
    assert network.samples("taxel/torsion/wrench", listen.WRENCH) == []
    (line,) = [line for line in err.splitlines() if "no wrench" in line]
    assert line.endswith("the stream has the fields force,point; it needs force,point,torsion")


def test_malformed_tool_is_a_usage_error(command: str):
    def refused(*tools: str) -> subprocess.CompletedProcess[str]:
        words = [word for tool in tools for word in ("--tool", tool)]
        bridge = [command, "bridge", "--zenoh", "--port", "sim:press", "--duration", "1", *words]
        return subprocess.run(bridge, capture_output=True, text=True, timeout=60)

    wrong = refused("1,2")
    assert wrong.returncode == 2 and "0,0,-20,0,0,90" in wrong.stderr
    many = refused("0,0,-20", "0,0,-25")
    assert many.returncode == 1 and "one for each --port" in many.stderr


def test_diagnostics_tell_faults_and_a_lost_finger(command: str, network: Network):
    network.subscribe("diagnostics", DIAGNOSTICS)

    def found(name: str) -> list[Any]:
        arrays = read(network, "diagnostics", DIAGNOSTICS)
        return [s for array in arrays for s in array.status if s.name == f"taxel/{name}: finger"]

    with bridge(command, network, ["sim:press", "sim:fault"]):
        wait(lambda: len(found("press")) > 3 and any(s.level == ERROR for s in found("fault")))
    sound = 0
    for status in found("press")[1:]:
        values = {pair.key: pair.value for pair in status.values}
        assert status.hardware_id == "press" and values["connections"] == "1"
        assert float(values["rate_hz"]) == pytest.approx(1000, rel=0.3)
        # A busy machine may overrun the virtual finger's scan.
        if set(values["flags"].split()) <= OF_THE_CONTACT and values["lost"] == "0":
            assert (status.level, status.message) == (OK, "sound")
            sound += 1
        else:
            assert status.level == WARN
    assert sound > 0
    fault = next(status for status in found("fault") if status.level == ERROR)
    assert "A taxel sees no light" in fault.message
    assert "dead-taxel" in {pair.key: pair.value for pair in fault.values}["flags"].split()
    network.topics.clear()
    with ExitStack() as plugged:
        port = plugged.enter_context(serve(command, "sim:press", "--tcp", "127.0.0.1:0"))
        with bridge(command, network, [port]):
            wait(lambda: any(status.level <= WARN for status in found("press")))
            plugged.close()
            wait(lambda: found("press")[-1].level == ERROR)
            assert port in found("press")[-1].message


def test_tare_and_self_test_are_triggers(command: str, network: Network, rest: str):
    services = Services(network)
    # The hash that rmw_zenoh's document gives, and so the way to compute it.
    documented = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    assert services.hash("example_interfaces/srv/AddTwoInts") == documented
    network.subscribe("taxel/frames", listen.FRAME)
    with bridge(command, network, [rest, "sim:fault-at-rest"]):
        wait(lambda: len(network.samples("taxel/frames", listen.FRAME)) > 100)
        frames = read(network, "taxel/frames", listen.FRAME)
        biased = 1 << 7
        assert not any(f.status & biased for f in frames if f.header.frame_id == "rest")
        tare = services.call("taxel/rest/tare", TRIGGER)
        assert (tare.success, tare.message) == (True, "bias taken over 1000 scans")
        test = services.call("taxel/rest/self_test", TRIGGER)
        assert test.success and "channels are sound" in test.message
        faulty = services.call("taxel/fault_at_rest/self_test", TRIGGER)
        assert not faulty.success and "hardly brighter" in faulty.message
        network.topics.clear()
        wait(lambda: len(network.samples("taxel/frames", listen.FRAME)) > 500)
        frames = read(network, "taxel/frames", listen.FRAME)
        assert all(f.status & biased for f in frames if f.header.frame_id == "rest")


def test_settings_are_parameters(command: str, network: Network, rest: str):
    services = Services(network)
    kind = "rcl_interfaces/srv/{}".format

    def request(name: str, **fields: Any) -> Any:
        return services.type(f"rcl_interfaces/action/{name}_Request")(**fields)

    def parameter(name: str, value: int | str) -> Any:
        number, text = (value, "") if isinstance(value, int) else (0, value)
        none: Any = np.array([])
        return services.type("rcl_interfaces/msg/Parameter")(
            name=name,
            value=services.type("rcl_interfaces/msg/ParameterValue")(
                type=2 if isinstance(value, int) else 4,
                bool_value=False,
                integer_value=number,
                double_value=0.0,
                string_value=text,
                byte_array_value=none.astype(np.uint8),
                bool_array_value=none.astype(np.bool_),
                integer_array_value=none.astype(np.int64),
                double_array_value=none,
                string_array_value=[],
            ),
        )

    def get(*names: str) -> list[Any]:
        asked = request("GetParameters", names=list(names))
        values = services.call("taxel/rest/get_parameters", kind("GetParameters"), asked).values
        return [{2: v.integer_value, 4: v.string_value, 0: None}[v.type] for v in values]

    def put(*parameters: Any) -> list[str]:
        asked = request("SetParameters", parameters=list(parameters))
        results = services.call("taxel/rest/set_parameters", kind("SetParameters"), asked).results
        return ["" if result.successful else result.reason for result in results]

    network.subscribe("taxel/frames", listen.FRAME)
    with bridge(command, network, [rest], "--rate", "1000"):
        wait(lambda: len(network.samples("taxel/frames", listen.FRAME)) > 100)
        asked = request("ListParameters", prefixes=[], depth=0)
        listed = services.call("taxel/rest/list_parameters", kind("ListParameters"), asked).result
        names = list(listed.names)
        assert names == ["rate_hz", "filter_hz", "fields", "point_method"]
        assert get("rate_hz", "filter_hz", "nonsense") == [1000, 0, None]
        asked = request("GetParameterTypes", names=names)
        kinds = services.call("taxel/rest/get_parameter_types", kind("GetParameterTypes"), asked)
        assert list(kinds.types) == [2, 2, 4, 4]
        asked = request("DescribeParameters", names=["filter_hz", "fields"])
        described = services.call("taxel/rest/describe_parameters", kind("DescribeParameters"), asked)
        hertz, fields = described.descriptors
        assert (hertz.name, hertz.type, hertz.integer_range[0].to_value) == ("filter_hz", 2, 250)
        assert (fields.name, fields.type, len(fields.integer_range)) == ("fields", 4, 0)
        assert put(parameter("rate_hz", 250), parameter("fields", "force,point,signals")) == ["", ""]
        assert get("rate_hz", "fields") == [250, "signals,force,point"]
        network.topics.clear()
        wait(lambda: len(network.samples("taxel/frames", listen.FRAME)) > 100)
        frames = read(network, "taxel/frames", listen.FRAME)[10:]
        assert set(np.diff([frame.device_us for frame in frames])) == {4000}
        assert {(len(frame.force), len(frame.slip)) for frame in frames} == {(3, 0)}
        # Each wish has its own outcome.
        wrong = put(parameter("rate_hz", 500), parameter("filter_hz", 900), parameter("rate", 1))
        assert wrong[0] == "" and "filter" in wrong[1] and "unknown parameter `rate`" in wrong[2]
        assert get("rate_hz", "filter_hz") == [500, 0]
        wrong = put(parameter("fields", "force,torque"), parameter("rate_hz", "fast"))
        assert "unknown field `torque`" in wrong[0] and "expected an integer" in wrong[1]
        # Together they are set all or none.
        both = [parameter("rate_hz", 200), parameter("filter_hz", 900)]
        asked = request("SetParametersAtomically", parameters=both)
        path = "taxel/rest/set_parameters_atomically"
        result = services.call(path, kind("SetParametersAtomically"), asked).result
        assert not result.successful and "filter" in result.reason
        assert get("rate_hz", "filter_hz") == [500, 0]
        # A malformed request has no reply, and the service goes on.
        key = services.key("taxel/rest/set_parameters", kind("SetParameters"))
        assert services.ask(key, b"\x00\x01\x00\x00\xff\xff\xff\xff") == []
        assert get("rate_hz") == [500]


def test_best_effort_is_announced(command: str, network: Network):
    with bridge(command, network, ["sim:press"], "--best-effort"):
        tokens = network.tokens(15)
    publishers = [token for token in tokens if "/MP/" in token]
    servers = [token for token in tokens if "/SS/" in token]
    assert len(publishers) == 6 and all(token.endswith("/2::,10:,:,:,,") for token in publishers)
    assert len(servers) == 8 and all(token.endswith("/::,10:,:,:,,") for token in servers)

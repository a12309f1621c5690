"""Tests of `taxel bridge --zenoh` with a Zenoh subscriber and another project's CDR decoder.

The expectations come from rmw_zenoh's design document, not from the bridge's source.
"""

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xxhash
from bridges import Network, Wrench, at, bridge, free_endpoint, listen, true_wrench, wait, wrench_of
from fingers import CALIBRATION, ROOT, replayed, rows

# Scenes of the fingers; each finger is named after its scene.
SCENES = [
    "press",
    "presses",
    "press-grid",
    "shear",
    "shear-ramp",
    "stick-slip",
    "roll",
    "torsion",
    "tap",
    "grasp",
]
REASONS = 8
ILL_CONDITIONED = 6
# A node, its publishers and its services.
ENTITIES = 1 + 6 + 8


def has_wrench(frame: Any) -> bool:
    """Returns whether force and place are known and no fault hides the torsion, or the force is zero."""
    known = all(value.withheld == 0 for value in frame.force)
    zero = all(value.value == 0 for value in frame.force)
    placed = all(value.withheld == 0 for value in frame.point)
    torsion = all(value.withheld in (0, ILL_CONDITIONED) for value in frame.torsion)
    return known and (zero or placed and torsion)


def torque_in_tilted_frame(wrench: Wrench) -> np.ndarray[Any, Any]:
    """Returns the torque about a point of the hand, in axes turned by 40 degrees about x."""
    force, torque = wrench
    sin, cos = np.sin(np.radians(40)), np.cos(np.radians(40))
    turn = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    from_hand = np.array([5e-3, -10e-3, 20e-3])
    turned: np.ndarray[Any, Any] = turn @ torque + np.cross(from_hand, turn @ force)
    return turned


def test_names_keys_and_tokens_match_rmw_zenoh(command: str, network: Network):
    network.subscribe("hand/press/wrench", listen.WRENCH)
    network.subscribe("hand/frames", listen.FRAME)
    with bridge(command, network, ["sim:press"], "--namespace", "/hand") as process:
        wait(lambda: len(network.samples("hand/frames", listen.FRAME)) > 100)
        node, *entities = sorted(network.tokens(ENTITIES), key=len)
        parts = node.split("/")
        assert parts[:2] == ["@ros2_lv", "3"]
        assert parts[4:] == [parts[3], "NN", "%", "%hand", "press"]
        assert parts[2] in {str(peer) for peer in network.session.info.peers_zid()}
        for topic, kind in (("hand/press/wrench", listen.WRENCH), ("hand/frames", listen.FRAME)):
            key, type_name, type_hash = listen.key(network.store, 3, topic, kind).rsplit("/", 2)
            assert key == f"3/{topic}"
            mangled = "%" + topic.replace("/", "%")
            (token,) = [t for t in entities if f"/{mangled}/" in t]
            tail = ["MP", "%", "%hand", "press", mangled, type_name, type_hash, "::,10:,:,:,,"]
            assert token.split("/")[:4] == parts[:4] and token.split("/")[5:] == tail
            # The publisher's identity is the hash of its token, low half first.
            gid = xxhash.xxh3_128_intdigest(token.encode()).to_bytes(16, "little")
            samples = network.samples(topic, kind)
            assert {s.publisher for s in samples} == {gid}
            numbers = [s.number for s in samples]
            assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
            assert all(0 <= s.at_ns - s.published_ns < 5e9 for s in samples)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        assert network.tokens(0) == []


def test_values_match_the_finger_bit_for_bit(command: str, network: Network, tmp_path: Path):
    trace, expected = replayed(command, "tour", tmp_path)
    network.subscribe("taxel/trace/wrench", listen.WRENCH)
    network.subscribe("taxel/frames", listen.FRAME)
    more = ["--calibration", str(CALIBRATION), "--fields", "all", "--json"]
    with bridge(command, network, [f"file:{trace}"], *more) as process:
        out, _ = process.communicate(timeout=60)
    (report,) = json.loads(out)
    assert report["lost"] == 0 and report["names"] == ["trace"]
    samples = network.samples("taxel/frames", listen.FRAME)
    frames = [network.store.deserialize_cdr(s.payload, listen.FRAME) for s in samples]
    assert len(frames) > 1000
    withheld = 0
    for frame in frames:
        assert frame.header.frame_id == "trace"
        row = expected[frame.device_us]
        assert frame.status == int(row["status"])
        for values, names, scale in (
            (frame.force, ["fx_n", "fy_n", "fz_n"], 1),
            (frame.point, ["x_mm", "y_mm"], 1e-3),
            (frame.torsion, ["torsion_nmm"], 1e-3),
            (frame.slip, ["slip_margin", "friction", "grip_n"], 1),
            (frame.sensors[:3], ["s0_fx_n", "s0_fy_n", "s0_fz_n"], 1),
        ):
            assert len(values) == len(names)
            for value, name in zip(values, names, strict=True):
                if row[name]:
                    theirs = np.float32(row[name]) * np.float32(scale)
                    assert (value.withheld, np.float32(value.value)) == (0, theirs), name
                else:
                    assert 1 <= value.withheld <= REASONS and value.value == 0
                    withheld += 1
        assert [np.float32(row[f"c_r{k // 4}c{k % 4}"]) for k in range(16)] == list(frame.taxels)
    assert withheld > 100
    # A missing force or place gives no wrench instead of a wrench of zero.
    wrenches = [
        network.store.deserialize_cdr(s.payload, listen.WRENCH)
        for s in network.samples("taxel/trace/wrench", listen.WRENCH)
    ]
    began = max(at(wrenches[0]), at(frames[0]))
    given = [f for f in frames if at(f) >= began and has_wrench(f)]
    wrenches = [wrench for wrench in wrenches if at(wrench) >= began]
    assert len(wrenches) == len(given) > 1000
    for stamped, frame in zip(wrenches, given, strict=True):
        force = stamped.wrench.force
        assert (force.x, force.y, force.z) == tuple(v.value for v in frame.force)
        assert stamped.header == frame.header
    truth = {int(row["t_us"]): row for row in rows(trace) if row["x_mm"]}
    errors = [
        torque_in_tilted_frame(wrench_of(stamped)) - torque_in_tilted_frame(true_wrench(true))
        for stamped, frame in zip(wrenches, given, strict=True)
        if (true := truth.get(frame.device_us)) is not None
    ]
    assert len(errors) > 1000
    assert np.abs(errors).max() < 0.3e-3, "N m"
    assert np.median(np.diff([at(frame) for frame in frames])) == pytest.approx(1e6, abs=2e5)


def test_lost_finger_is_awaited_and_names_are_unique(command: str, network: Network):
    with bridge(command, network, ["tcp:127.0.0.1:1", "sim:press"], "--duration", "2") as process:
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0
    assert err.count("tcp:127.0.0.1:1: connection refused") == 1 and "waiting for it" in err
    assert "tcp:127.0.0.1:1: never there" in out and "sim:press: press, " in out
    with bridge(command, network, ["sim:press", "sim:press"]) as process:
        _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "another finger is called press already" in err.splitlines()[-1]


def test_late_router_is_found(command: str, store: Any):
    network = Network(store, 3, free_endpoint())
    network.session.close()
    with bridge(command, network, ["sim:press"]) as process:
        assert process.stderr is not None and "node /taxel/press" in process.stderr.readline()
        later = Network(store, 3, network.endpoint)
        later.subscribe("taxel/press/wrench", listen.WRENCH)
        wait(lambda: len(later.samples("taxel/press/wrench", listen.WRENCH)) > 100)
        later.session.close()


def test_invalid_endpoint_is_an_error_in_one_line(command: str, network: Network):
    with bridge(command, network, ["sim:press"], "--listen", "nonsense") as process:
        _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert len(err.splitlines()) == 1 and "check --connect and --listen" in err


def test_ten_fingers_at_1_khz_lose_nothing(command: str, network: Network):
    network.subscribe("taxel/*/wrench", listen.WRENCH)
    ports = [f"sim:{scene}" for scene in SCENES]
    with bridge(command, network, ports, "--json") as process:
        # Some seconds of every finger, from its first sample on.
        wait(lambda: len(network.topics) == len(SCENES), 120)
        topics = network.topics.values()
        wait(lambda: all(len(topic.samples) > 2000 for topic in topics), 120)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=120)
    reports = json.loads(out)
    assert len(reports) == len(SCENES)
    assert [report["lost"] for report in reports] == [0] * len(SCENES)
    assert [topic.lost() for topic in topics] == [0] * len(SCENES)
    samples = [s for topic in topics for s in topic.samples]
    assert 20_000 < len(samples) <= sum(report["frames"] - report["withheld"] for report in reports)
    late = listen.percentiles([(s.at_ns - s.published_ns) * 1e-6 for s in samples])
    print(f"{len(samples)} wrenches of {len(SCENES)} fingers, 0 lost, ms late: {late}")


def test_commands_of_the_manual_work(command: str, tmp_path: Path):
    """Runs each `taxel bridge` line of the manuals' `sh` blocks, and the listener next to the bridge."""

    def lines(manual: str) -> list[str]:
        blocks = [block.split("```")[0] for block in (ROOT / manual).read_text().split("```sh\n")[1:]]
        return [line for block in blocks for line in block.splitlines() if line.startswith("taxel bridge ")]

    (line,) = lines("docs/getting-started.md")
    # The address of the manual may be in use; whether it is free is not this test's matter.
    words = line.replace("--foxglove", "--foxglove 127.0.0.1:0").split()[1:]
    ran = subprocess.run([command, *words], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    assert "topic /taxel/tour, and below it /scene, /log, /contact, /tf" in ran.stderr
    ros = lines("docs/ros2.md")
    assert ros
    for line in ros:
        ran = subprocess.run(
            [command, *line.split()[1:]], cwd=tmp_path, capture_output=True, text=True, timeout=60
        )
        assert ran.returncode == 0, ran.stderr
        assert "node /taxel/press, topics /taxel/press/wrench and /taxel/frames" in ran.stderr
    endpoint = free_endpoint()
    listener = subprocess.Popen(
        # Enough for a bridge that starts slowly and sends four seconds.
        [sys.executable, str(ROOT / "host-tools/ros2/listen.py"), "--seconds", "20"] + ["--listen", endpoint],
        stdout=subprocess.PIPE,
        text=True,
    )
    host, _, port = endpoint.removeprefix("tcp/").partition(":")
    wait(lambda: socket.socket().connect_ex((host, int(port))) == 0)
    fingers = ["--port", "sim:press", "--port", "sim:shear", "--connect", endpoint]
    run = [command, "bridge", "--zenoh", *fingers, "--duration", "4"]
    subprocess.run(run, capture_output=True, check=True)
    out, _ = listener.communicate(timeout=30)
    assert "0/taxel/press/wrench: " in out and "0/taxel/shear/wrench: " in out
    assert "2 fingers, " in out and ", 0 lost" in out and "median" in out

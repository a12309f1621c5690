"""A Zenoh network in which bridges publish, and other projects' decoder of what they send."""

import importlib.util
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import zenoh
from fingers import ROOT

Wrench = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


listen = load(ROOT / "host-tools/ros2/listen.py")


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class Network:
    """A subscriber's session with all samples that bridges publish."""

    def __init__(self, store: Any, domain: int, endpoint: str) -> None:
        self.store, self.domain, self.endpoint = store, domain, endpoint
        self.session = listen.open_session(endpoint, None)
        self.topics: dict[str, Any] = {}

    def subscribe(self, topic: str, kind: str) -> None:
        def take(sample: zenoh.Sample) -> None:
            self.topics.setdefault(str(sample.key_expr), listen.Topic()).take(sample)

        self.session.declare_subscriber(listen.key(self.store, self.domain, topic, kind), take)

    def samples(self, topic: str, kind: str) -> list[Any]:
        found = self.topics.get(listen.key(self.store, self.domain, topic, kind))
        return [] if found is None else found.samples

    def tokens(self, count: int) -> list[str]:
        """Waits for that many liveliness tokens and returns them."""
        found: list[str] = []

        def all_there() -> bool:
            replies = self.session.liveliness().get("@ros2_lv/**", timeout=2.0)
            found[:] = sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
            return len(found) == count

        wait(all_there)
        return found


@contextmanager
def bridge(command: str, network: Network, ports: list[str], *more: str) -> Iterator[Any]:
    fingers = [word for port in ports for word in ("--port", port)]
    process = subprocess.Popen(
        [command, "bridge", "--zenoh", *fingers, "--connect", network.endpoint, *more]
        + ["--domain", str(network.domain)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.wait(20)


def wait(condition: Callable[[], bool], seconds: float = 30) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came about"
        time.sleep(0.02)


def wrench_of(stamped: Any) -> Wrench:
    """Returns a message's force in N and torque in N m."""
    force, torque = stamped.wrench.force, stamped.wrench.torque
    return np.array([force.x, force.y, force.z]), np.array([torque.x, torque.y, torque.z])


def true_wrench(row: dict[str, str]) -> Wrench:
    """Returns the simulated force in N, and its moment about the middle of the skin in N m."""
    force = np.array([float(row[name]) for name in ("fx_n", "fy_n", "fz_n")])
    place = np.array([float(row["x_mm"]), float(row["y_mm"]), 0.0])
    torsion = np.array([0.0, 0.0, float(row["torsion_nmm"])])
    return force, 1e-3 * (np.cross(place, force) + torsion)


def at(message: Any) -> int:
    """Returns a message's timestamp in nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)

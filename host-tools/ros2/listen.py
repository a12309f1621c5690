#!/usr/bin/env python3
"""Listens to every finger in a Zenoh network, without ROS: pip install eclipse-zenoh rosbags.

Fingers connect to it as they would to a ROS 2 system's router: start it beside `taxel bridge --zenoh`.
"""

from __future__ import annotations

import argparse
import json
import struct
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

WRENCH = "geometry_msgs/msg/WrenchStamped"
FRAME = "taxel_msgs/msg/Frame"


def typestore() -> Any:
    """The types of ROS 2 and ours, from the definitions that a ROS 2 system builds them of."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for message in sorted((Path(__file__).parent / "taxel_msgs/msg").glob("*.msg"), reverse=True):
        store.register(get_types_from_msg(message.read_text(), f"taxel_msgs/msg/{message.stem}"))
    return store


def key(store: Any, domain: int, topic: str, kind: str) -> str:
    """The key that rmw_zenoh publishes a topic under."""
    package, _, name = kind.split("/")
    return f"{domain}/{topic}/{package}::msg::dds_::{name}_/{store.hash_rihs01(kind)}"


def open_session(listen: str | None, connect: str | None) -> zenoh.Session:
    """A peer that is connected to, or connects."""
    config: dict[str, Any] = {"mode": "peer", "scouting": {"multicast": {"enabled": False}}}
    if listen:
        config["listen"] = {"endpoints": [listen]}
    if connect:
        config["connect"] = {"endpoints": [connect]}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


@dataclass
class Sample:
    """A sample as it came: nothing is decoded while others wait."""

    at_ns: int
    number: int
    published_ns: int
    publisher: bytes
    payload: bytes


@dataclass
class Topic:
    """What came on a topic."""

    samples: list[Sample] = field(default_factory=list)

    def take(self, sample: zenoh.Sample) -> None:
        """Takes a sample: its attachment says which it is, when it was published, and by whom."""
        at = time.time_ns()
        attachment = sample.attachment
        if attachment is not None:
            number, published, length = struct.unpack_from("<qqB", attachment.to_bytes())
            publisher = attachment.to_bytes()[17 : 17 + length]
            self.samples.append(Sample(at, number, published, publisher, sample.payload.to_bytes()))

    def lost(self) -> int:
        """Samples that were published between the first and the last and never came."""
        lost = 0
        for publisher in {s.publisher for s in self.samples}:
            numbers = [s.number for s in self.samples if s.publisher == publisher]
            lost += numbers[-1] - numbers[0] + 1 - len(numbers)
        return lost


def percentiles(values: list[float]) -> str:
    """A distribution in words."""
    values = sorted(values)
    at = {name: values[int(q * (len(values) - 1))] for name, q in SHARES.items()}
    return ", ".join(f"{name} {value:.2f}" for name, value in at.items())


SHARES = {"least": 0.0, "median": 0.5, "95 %": 0.95, "99 %": 0.99, "99.9 %": 0.999, "most": 1.0}


def main() -> None:
    """Counts what comes, and how late."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--listen", metavar="ENDPOINT", default="tcp/127.0.0.1:7447")
    parser.add_argument("--connect", metavar="ENDPOINT", help="a router, instead")
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=10.0)
    args = parser.parse_args()
    store, topics = typestore(), dict[str, Topic]()

    def take(sample: zenoh.Sample) -> None:
        topics.setdefault(str(sample.key_expr).split("/geometry_msgs")[0], Topic()).take(sample)

    with open_session(None if args.connect else args.listen, args.connect) as session:
        subscriber = session.declare_subscriber(key(store, args.domain, "**", WRENCH), take)
        time.sleep(args.seconds)
        subscriber.undeclare()
    for name, topic in sorted(topics.items()):
        wrench = store.deserialize_cdr(topic.samples[-1].payload, WRENCH)
        span = (topic.samples[-1].at_ns - topic.samples[0].at_ns) * 1e-9
        print(
            f"{name}: {len(topic.samples)} wrenches, {topic.lost()} lost, "
            f"{(len(topic.samples) - 1) / max(span, 1e-9):.0f} Hz, last fz {wrench.wrench.force.z:.3f} N"
        )
    everything = [sample for topic in topics.values() for sample in topic.samples]
    if everything:
        lost = sum(topic.lost() for topic in topics.values())
        print(f"{len(topics)} fingers, {len(everything)} wrenches, {lost} lost")
        print(
            "ms from publishing to here:",
            percentiles([(s.at_ns - s.published_ns) * 1e-6 for s in everything]),
        )


if __name__ == "__main__":
    main()

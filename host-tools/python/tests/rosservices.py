"""Calls a node's services as rmw_zenoh does, with another project's decoder."""

import struct
import time
from typing import Any

import zenoh
from bridges import Network
from rosbags.typesys import get_types_from_msg

# Definitions by service: request and response.
DEFINITIONS = {
    "example_interfaces/srv/AddTwoInts": ("int64 a\nint64 b", "int64 sum"),
    "std_srvs/srv/Trigger": ("", "bool success\nstring message"),
    "rcl_interfaces/srv/ListParameters": (
        "string[] prefixes\nuint64 depth",
        "rcl_interfaces/ListParametersResult result",
    ),
    "rcl_interfaces/srv/GetParameters": ("string[] names", "rcl_interfaces/ParameterValue[] values"),
    "rcl_interfaces/srv/GetParameterTypes": ("string[] names", "uint8[] types"),
    "rcl_interfaces/srv/DescribeParameters": (
        "string[] names",
        "rcl_interfaces/ParameterDescriptor[] descriptors",
    ),
    "rcl_interfaces/srv/SetParameters": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult[] results",
    ),
    "rcl_interfaces/srv/SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters",
        "rcl_interfaces/SetParametersResult result",
    ),
}
CLIENT = bytes(range(16))


def renamed(value: Any, old: str, new: str) -> Any:
    if isinstance(value, str):
        return value.replace(old, new)
    if isinstance(value, (tuple, list)):
        return type(value)(renamed(part, old, new) for part in value)
    return value


class Services:
    """Client of the services of a Zenoh network."""

    def __init__(self, network: Network) -> None:
        self.network, self.store, self.number = network, network.store, 0
        # A `char` of a message is an unsigned byte (ROS 2's interface definition).
        event = "service_msgs/msg/ServiceEventInfo"
        constants, fields = self.store.fielddefs[event]
        self.store.fielddefs[event] = constants, renamed(fields, "char", "uint8")
        for name, (request, response) in DEFINITIONS.items():
            # The decoder knows messages and actions only; the names matter to the hash.
            self.define(f"{name}_Request", request)
            self.define(f"{name}_Response", response)
            info = "service_msgs/ServiceEventInfo info"
            both = f"{name}_Request[<=1] request\n{name}_Response[<=1] response"
            self.define(f"{name}_Event", f"{info}\n{both}")
            parts = ("Request request", "Response response", "Event event")
            self.define(name, "\n".join(f"{name}_{part}_message" for part in parts))

    def define(self, name: str, text: str) -> None:
        action = name.replace("/srv/", "/action/")
        self.store.register(get_types_from_msg(text.replace("/srv/", "/action/"), action))
        self.store.fielddefs[name] = renamed(self.store.fielddefs[action], "/action/", "/srv/")

    def hash(self, kind: str) -> str:
        return str(self.store.hash_rihs01(kind))

    def key(self, service: str, kind: str) -> str:
        package, _, name = kind.split("/")
        return f"{self.network.domain}/{service}/{package}::srv::dds_::{name}_/{self.hash(kind)}"

    def type(self, name: str) -> Any:
        return self.store.types[name]

    def call(self, service: str, kind: str, request: Any = None) -> Any:
        """Returns the response; checks that its attachment repeats number and client."""
        action = kind.replace("/srv/", "/action/")
        if request is None:
            # An empty message has one byte.
            payload = b"\x00\x01\x00\x00\x00"
        else:
            payload = bytes(self.store.serialize_cdr(request, f"{action}_Request"))
        (reply,) = self.ask(self.key(service, kind), payload)
        number, at, length = struct.unpack_from("<qqB", reply.attachment.to_bytes())
        assert (number, length) == (self.number, len(CLIENT))
        assert reply.attachment.to_bytes()[17:] == CLIENT
        assert abs(time.time_ns() - at) < 10e9
        return self.store.deserialize_cdr(reply.payload.to_bytes(), f"{action}_Response")

    def ask(self, key: str, payload: bytes) -> list[Any]:
        self.number += 1
        attachment = struct.pack("<qqB", self.number, time.time_ns(), len(CLIENT)) + CLIENT
        target = zenoh.QueryTarget.ALL_COMPLETE
        consolidation = zenoh.ConsolidationMode.NONE
        replies = self.network.session.get(
            key,
            payload=payload,
            attachment=attachment,
            target=target,
            consolidation=consolidation,
            timeout=20.0,
        )
        return [reply.ok for reply in replies if reply.ok is not None]

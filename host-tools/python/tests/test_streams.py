"""Tests of one stream in two clients: `taxel record` live, and this package from the kept bytes."""

import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest
from fingers import serve

import taxel
from taxel import Fields, Frame, NoValue, Uncertainty

SECONDS = 3


@contextmanager
def tapped(port: str) -> Iterator[tuple[str, bytearray]]:
    """Serves a port that forwards to ``port``; yields it and all bytes that came back."""
    host, _, number = port.removeprefix("tcp:").rpartition(":")
    kept = bytearray()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def carry() -> None:
            client, _ = server.accept()
            with client, socket.create_connection((host, int(number))) as finger:
                asking = threading.Thread(target=forward, args=(client, finger, None))
                asking.start()
                forward(finger, client, kept)
                asking.join()

        carrying = threading.Thread(target=carry)
        carrying.start()
        yield f"tcp:127.0.0.1:{server.getsockname()[1]}", kept
        carrying.join(30)
        assert not carrying.is_alive()


def forward(source: socket.socket, sink: socket.socket, kept: bytearray | None) -> None:
    try:
        while data := source.recv(65536):
            if kept is not None:
                kept += data
            sink.sendall(data)
    except OSError:
        # Either side may hang up in the middle of a stream.
        pass
    for end in (source, sink):
        try:
            end.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass


@pytest.fixture(scope="module")
def both(command: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, list[Frame]]:
    """Returns the frames of the Rust client and this package's frames of the same bytes."""
    recording = tmp_path_factory.mktemp("streams") / "rust.parquet"
    with serve(command, "sim:tour", "--tcp", "127.0.0.1:0") as finger:
        with tapped(finger) as (port, kept):
            record = [command, "record", "--port", port, "--fields", "all", "--duration", str(SECONDS)]
            subprocess.run([*record, "--out", str(recording)], check=True, timeout=60)
    rust = pd.read_parquet(recording)
    # The pieces end at arbitrary bytes.
    pieces = [bytes(kept[at : at + 997]) for at in range(0, len(kept), 997)]
    wanted = set(rust["seq"])
    return rust, [frame for frame in taxel.read_frames(pieces) if frame.seq in wanted]


def test_both_find_the_same_frames(both: tuple[pd.DataFrame, list[Frame]]):
    rust, frames = both
    assert len(rust) == SECONDS * 1000
    assert [frame.seq for frame in frames] == list(rust["seq"])


def test_both_read_the_same_values_to_the_last_bit(both: tuple[pd.DataFrame, list[Frame]]):
    rust, frames = both
    table = taxel.columns(frames, Fields.ALL)
    ours = [name for name in rust.columns if not name.endswith("_withheld")]
    host = ["host_us", "host_scan_us", "host_scan_error_us", "connection"]
    assert [*table] == [name for name in ours if name not in host]
    for name, column in table.items():
        theirs = rust[name].astype(np.float64)
        np.testing.assert_array_equal(column.astype(np.float64), theirs, err_msg=name)
    assert np.nanmax(table["fz_n"]) > 0.1


def test_both_read_the_same_reasons(both: tuple[pd.DataFrame, list[Frame]]):
    rust, frames = both
    seen = set()

    def same(names: list[str], values: list[object]) -> None:
        for name in names:
            reasons = [v.name.lower().replace("_", " ") if isinstance(v, NoValue) else None for v in values]
            theirs = [None if pd.isna(w) else w.replace("-", " ") for w in rust[f"{name}_withheld"]]
            assert reasons == theirs, name
            seen.update(reason for reason in reasons if reason is not None)

    for k, axis in enumerate("xyz"):
        same([f"f{axis}_n"], [frame.force[k] for frame in frames if frame.force])
        for s in range(4):
            same([f"s{s}_f{axis}_n"], [frame.sensors[s][k] for frame in frames if frame.sensors])
    same(["x_mm", "y_mm"], [frame.point for frame in frames])
    same(["torsion_nmm"], [frame.torsion_nmm for frame in frames])
    same(["slip_margin", "friction", "grip_n"], [frame.slip for frame in frames])
    contacts = [f"contact{i}_{name}" for i in (1, 2) for name in ("x_mm", "y_mm", "fz_n")]
    same(contacts, [frame.contacts for frame in frames])
    sure = [frame.uncertainty for frame in frames]
    same(["misfit"], [known.misfit if isinstance(known, Uncertainty) else known for known in sure])
    assert "no contact" in seen, seen

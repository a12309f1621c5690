"""Fixtures of all tests."""

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="session")
def command() -> str:
    """Path of the `taxel` command with its bridges: `TAXEL=path/to/taxel`, else cargo builds it."""
    if "TAXEL" in os.environ:
        return os.environ["TAXEL"]
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    build = ["cargo", "build", "--quiet", "--target-dir", str(target), "--bin", "taxel"]
    subprocess.run([*build, "--features", "zenoh,foxglove"], cwd=ROOT, check=True)
    return str(target / "debug" / "taxel")


@pytest.fixture(scope="session")
def store() -> Any:
    """The types of ROS 2 and ours, of another project's CDR decoder."""
    from bridges import listen

    return listen.typestore()


@pytest.fixture
def network(store: Any) -> Iterator[Any]:
    """A Zenoh network for bridges to publish in."""
    from bridges import Network, free_endpoint

    network = Network(store, 3, free_endpoint())
    yield network
    network.session.close()

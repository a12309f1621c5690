"""Fixtures of all tests."""

import os
import subprocess
from pathlib import Path

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

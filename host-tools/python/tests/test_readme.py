"""Test that runs the README's Python as written, with a virtual finger as the only one on USB."""

import re
from pathlib import Path

import pytest
from fingers import ROOT, serve

from taxel import Found, ports


def test_readme_runs_as_written(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    text = (ROOT / "host-tools/python/README.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 4
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    with serve(command, "sim:tour") as device:
        monkeypatch.setattr(ports, "fingers", lambda: [Found("tour", device)])
        for block in blocks:
            exec(block, names)

"""Endurance test: 4 kHz into the page, MCAP and Parquet at once.

`TAXEL_ENDURE_S=600 pytest tests/test_endurance.py -s` runs for ten minutes; the default is some seconds.
"""

import json
import os
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from fingers import FAST, serve
from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

SECONDS = float(os.environ.get("TAXEL_ENDURE_S", "6"))
TICKS = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")


def used(pid: int) -> tuple[float, float]:
    """Returns the CPU seconds so far and the resident memory in MiB."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    resident = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return (int(fields[11]) + int(fields[12])) / TICKS, resident * PAGE / 2**20


def watch(url: str, messages: list[str]) -> None:
    """Acts as an open page that reads every message."""
    with connect(url.strip().replace("http", "ws") + "finger/0", max_size=None) as page:
        try:
            for message in page:
                messages.append(str(message)[:200])
        except ConnectionClosed:
            pass


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from Linux's /proc")
def test_4_khz_reach_page_mcap_and_parquet(command: str, tmp_path: Path):
    scene = tmp_path / "fast.toml"
    scene.write_text(FAST)
    record = [command, "record", "--rate", "4000", "--fields", "all", "--page", "127.0.0.1:0", "--json"]
    files = ["--out", "a.mcap", "--out", "a.parquet", "--duration", str(SECONDS)]
    with serve(command, f"sim:{scene}", "--tcp", "127.0.0.1:0") as port:
        process = subprocess.Popen(
            [*record, *files, "--port", port],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stderr is not None and process.stdout is not None
        messages: list[str] = []
        page = threading.Thread(target=watch, args=(process.stderr.readline(), messages))
        page.start()
        began, (cpu, _), memory = time.monotonic(), used(process.pid), []
        while (elapsed := time.monotonic() - began) < SECONDS * 0.95:
            memory.append(used(process.pid)[1])
            time.sleep(min(1.0, SECONDS / 20))
        share = (used(process.pid)[0] - cpu) / elapsed
        out, err = process.communicate(timeout=120 + SECONDS / 2)
        page.join()
    assert process.returncode == 0, err
    summary = json.loads(out)
    assert summary["lost"] == summary["bad_packets"] == summary["gaps"] == 0
    assert summary["frames"] == pytest.approx(4000 * SECONDS, abs=2)
    with (tmp_path / "a.mcap").open("rb") as file:
        contents = make_reader(file).get_summary()
    assert contents is not None and contents.statistics is not None
    names = {id_: contents.schemas[channel.schema_id].name for id_, channel in contents.channels.items()}
    (frames,) = (id_ for id_, name in names.items() if name == "taxel.Frame")
    assert contents.statistics.channel_message_counts[frames] == summary["frames"]
    seq = pq.read_table(tmp_path / "a.parquet", columns=["seq"])["seq"].to_numpy()
    assert len(seq) == summary["frames"] and set(np.diff(seq)) == {1}
    # At most sixty a second; a slow page gets fewer messages without losing frames.
    assert len(messages) > 5 * SECONDS
    quarter = max(1, len(memory) // 4)
    early, late = np.median(memory[quarter : 2 * quarter]), np.median(memory[-quarter:])
    assert late - early < 16, memory
    print(
        f"{summary['frames']} frames in {SECONDS:.0f} s, 0 lost; {share:.2f} of a core; "
        f"{early:.1f} MiB early, {late:.1f} MiB late; {len(messages)} messages to the page"
    )

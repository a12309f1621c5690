"""Logs fingers without ROS: a CSV file each, on one clock, until Ctrl-C or the end of --seconds.

    python log.py usb:F-0042 usb:F-0043 --folder today
    python log.py sim:tour --seconds 5

Rows of different fingers are matched by ``host_scan_us``, the time of the scan by this machine's clock.
`taxel export` makes MCAP or Parquet of a file, :func:`taxel.read` arrays.
"""

import argparse
import asyncio
import re
from pathlib import Path

import taxel
from taxel import AsyncFinger, Fields, Finger


async def log(port: str, folder: Path, seconds: float | None) -> str:
    """Logs one finger; returns how it went."""
    path = folder / f"{re.sub('[^A-Za-z0-9.-]+', '-', port)}.csv"
    async with AsyncFinger(port) as finger:
        await finger.ask(Finger.set_fields, Fields.ALL)
        with await finger.ask(Finger.record, path) as recorder:
            async for frame in finger.frames(seconds):
                if frame.seq % 1000 == 0:
                    print(f"{port}: {recorder.frames} rows, {finger.counts.lost} lost, force {frame.force}")
        return f"{port}: {recorder.frames} rows in {path}, {finger.counts.lost} lost"


async def log_all(ports: list[str], folder: Path, seconds: float | None) -> bool:
    folder.mkdir(parents=True, exist_ok=True)
    ends = await asyncio.gather(*(log(port, folder, seconds) for port in ports), return_exceptions=True)
    for end in ends:
        if isinstance(end, BaseException) and not isinstance(end, taxel.TaxelError):
            raise end
        print(end)
    return not any(isinstance(end, taxel.TaxelError) for end in ends)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("ports", nargs="*", default=["usb"])
    parser.add_argument("--folder", type=Path, default=Path("."))
    parser.add_argument("--seconds", type=float)
    words = parser.parse_args()
    try:
        raise SystemExit(0 if asyncio.run(log_all(words.ports, words.folder, words.seconds)) else 1)
    except KeyboardInterrupt:
        print("stopped; the files are whole")


if __name__ == "__main__":
    main()

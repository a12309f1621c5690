"""Device time in the host's time, as ``taxel record`` maps it (host-tools/client/src/clock.rs).

A frame is received at least one link delay after its scan. The earliest frame of each second bounds the
clock: the closest line below all of them has the device's rate as slope (lower convex hull; Moon, Skelly and
Towsley, INFOCOM 1999). Half the shortest round trip is subtracted and counted as error.
"""

from __future__ import annotations

import time
from collections import deque
from typing import NamedTuple

BUCKET = 1.0
"""Seconds per interval, of which only the earliest frame is kept."""

KEPT = 120
"""Number of intervals that are kept."""

LEAST_SPAN = 10.0
"""Seconds before the device's rate is estimated."""

UNKNOWN_RATE = 200e-6
"""Largest difference in rate before it is estimated: two crystals at 100 ppm."""

Point = tuple[float, float]


class HostTime(NamedTuple):
    """Time of a scan by the host's clocks, in seconds."""

    monotonic_s: float
    """As :func:`time.monotonic`, for control loops."""
    unix_s: float
    """As :func:`time.time`, to compare with other recordings."""
    error_s: float
    """Bound on the error, from the link's delays."""


class DeviceClock:
    """Device clock, estimated from received frames and round trips."""

    def __init__(self) -> None:
        self._echo: float | None = None
        self._unix = time.time() - time.monotonic()
        self._restart(None)

    def _restart(self, origin: Point | None) -> None:
        self._origin = origin
        self._last = 0.0
        self._earliest: deque[Point] = deque(maxlen=KEPT)
        self._slope: float | None = None
        self._offset = self._touches = self._spread = 0.0

    def echo(self, seconds: float) -> None:
        """Adds a round-trip time."""
        self._echo = seconds if self._echo is None else min(self._echo, seconds)

    def frame(self, time_us: int, received: float) -> None:
        """Adds a frame of this device time, received at this :func:`time.monotonic`."""
        device = time_us * 1e-6
        if self._origin is None or device - self._origin[0] < self._last:
            # The first frame, or the device has restarted.
            self._restart((device, received))
        assert self._origin is not None
        now = device - self._origin[0]
        self._last = now
        late = received - self._origin[1] - now
        if self._earliest and self._earliest[-1][0] // BUCKET == now // BUCKET:
            if late < self._earliest[-1][1]:
                self._earliest[-1] = (now, late)
            return
        self._fit()
        self._earliest.append((now, late))

    def host(self, time_us: int) -> HostTime | None:
        """Converts device time; ``None`` in the first second of a stream."""
        if self._origin is None or self._echo is None or len(self._earliest) < 2:
            return None
        now = time_us * 1e-6 - self._origin[0]
        late = self._offset + (self._slope or 0.0) * now - self._echo / 2
        apart = UNKNOWN_RATE * abs(now - self._touches) if self._slope is None else 0.0
        monotonic = self._origin[1] + now + late
        return HostTime(monotonic, monotonic + self._unix, self._echo / 2 + self._spread + apart)

    def _fit(self) -> None:
        """Fits the line below the earliest frames of all complete intervals."""
        points = list(self._earliest)
        if not points:
            return
        self._touches, self._offset = min(points, key=lambda point: point[1])
        self._slope = None
        if points[-1][0] - points[0][0] >= LEAST_SPAN:
            (t0, y0), (t1, y1) = _edge(points)
            self._slope = (y1 - y0) / (t1 - t0)
            self._offset = y0 - self._slope * t0
        # The median, because an interval of late frames only says nothing about the clock.
        above = sorted(late - self._offset - (self._slope or 0.0) * t for t, late in points)
        self._spread = above[len(above) // 2]


def _edge(points: list[Point]) -> tuple[Point, Point]:
    """Returns the edge of the lower convex hull at the middle of the time."""
    hull: list[Point] = []
    for point in points:
        while len(hull) > 1:
            a, b = hull[-2:]
            if (b[0] - a[0]) * (point[1] - a[1]) > (point[0] - a[0]) * (b[1] - a[1]):
                break
            hull.pop()
        hull.append(point)
    middle = sum(t for t, _ in points) / len(points)
    edges = zip(hull, hull[1:], strict=False)
    return next((a, b) for a, b in edges if a[0] <= middle <= b[0])

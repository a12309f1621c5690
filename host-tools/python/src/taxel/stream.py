"""Received frames on their way to the program: none goes missing without being counted."""

from __future__ import annotations

import threading
import time
import warnings
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from .clock import DeviceClock, HostTime
from .errors import LinkError, StaleError, StreamWarning, TaxelError
from .messages import Frame

QUEUE = 8192
"""Most frames that wait for a slow program; then the oldest is dropped and counted."""

BEHIND_S = 1.0
"""Seconds of device time that a program may be behind before it is warned."""

DUPLICATES = 256
"""Most frames by which a number may step back as a duplicate; further back, the finger has restarted."""

FASTEST_HZ = 10_000.0
"""Most frames a second of any finger."""

HELD_BACK_S = 10.0
"""Seconds for which a link may hold frames back."""


Listener = Callable[[Frame, float, HostTime | None], None]
"""Takes a frame, its :func:`time.monotonic` of reception, and its host time."""


class Counts(NamedTuple):
    """Counters since the start of the stream.

    Each frame that the finger sent is received or lost; each received one was given to the program, skipped,
    dropped, or waits: ``frames == given + skipped + overflow + waiting``.
    """

    frames: int
    """Frames received."""
    lost: int
    """Frames missing in the sequence numbers."""
    bad_packets: int
    """Unreadable packets."""
    overflow: int
    """Received frames that were dropped because :data:`QUEUE` others waited."""
    skipped: int
    """Received frames that ``latest()`` passed over because a newer one was there."""
    waiting: int
    """Received frames that the program has not taken yet."""
    given: int
    """Received frames that the program has taken."""


class Latest(NamedTuple):
    """The newest frame, and how new it is."""

    frame: Frame
    age_s: float
    """Seconds since its reception."""
    new: bool
    """False if an earlier call already returned it."""
    skipped: int
    """Frames between the last one that was taken and this one."""


class Stream:
    """Frames between the reading thread and the program; ``changed`` guards all of it."""

    def __init__(self, port: str) -> None:
        self.port = port
        self.changed = threading.Condition()
        self.clock = DeviceClock()
        self.ended: TaxelError | None = None
        self.started = False
        self.listeners: list[Listener] = []
        """Called with each frame by the reading thread; must return at once."""
        self.wakers: list[Callable[[], None]] = []
        """Called by the reading thread after new frames or the end; must return at once."""
        self._reset()

    def _reset(self) -> None:
        self._frames: deque[Frame] = deque()
        self._newest: tuple[Frame, float] | None = None
        self._next: int | None = None
        self._received = self._lost = self._overflow = self._skipped = self._given = 0
        self._told: set[str] = set()

    def start(self) -> None:
        """Begins the counts again and drops what waits."""
        self._reset()
        self.started = True

    def push(self, frame: Frame, at: float) -> None:
        """Adds a frame, received at this :func:`time.monotonic`."""
        if not self.started:
            return
        self._received += 1
        self._lost += self._missing(frame.seq, at)
        self.clock.frame(frame.time_us, at)
        if len(self._frames) == QUEUE:
            self._frames.popleft()
            self._overflow += 1
        self._frames.append(frame)
        self._newest = frame, at
        if self.listeners:
            host = self.clock.host(frame.time_us)
            for listener in self.listeners:
                listener(frame, at, host)

    def _missing(self, seq: int, at: float) -> int:
        """Returns how many frames are missing between the last one and this.

        A gap of more frames than a finger sends in that time is a restart.
        """
        ahead = 0 if self._next is None else (seq - self._next) & 0xFFFF_FFFF
        since = at - self._newest[1] if self._newest else 0.0
        possible = ahead <= FASTEST_HZ * (since + HELD_BACK_S)
        if possible or (1 << 32) - ahead > DUPLICATES:
            self._next = (seq + 1) & 0xFFFF_FFFF
        return ahead if possible else 0

    def wake(self) -> None:
        """Wakes who waits for frames or the end."""
        self.changed.notify_all()
        for waker in self.wakers:
            waker()

    def is_live(self) -> bool:
        """True while frames come in: one within the last second."""
        with self.changed:
            at = self._newest[1] if self._newest and self.ended is None else -BEHIND_S
            return time.monotonic() - at < BEHIND_S

    def counts(self, bad_packets: int) -> Counts:
        """Returns the counters at one moment."""
        with self.changed:
            waiting = len(self._frames)
            received = self._received, self._lost, bad_packets
            return Counts(*received, self._overflow, self._skipped, waiting, self._given)

    def next(self, timeout: float) -> Frame:
        """Returns the oldest waiting frame; waits at most ``timeout`` seconds for one."""
        with self.changed:
            if not self._frames:
                self._wait(lambda: bool(self._frames), timeout)
        frame = self.poll()
        if frame is None:
            raise self._silent(timeout)
        return frame

    def poll(self) -> Frame | None:
        """Returns the oldest waiting frame, if any; raises what ended the stream after the last one."""
        with self.changed:
            if not self._frames:
                if self.ended is not None:
                    raise self.ended
                return None
            frame = self._frames.popleft()
            self._given += 1
            behind = (self._newest[0].time_us - frame.time_us) * 1e-6 if self._newest else 0.0
            waiting, told = len(self._frames), self._news(behind)
        if told:
            self._tell(told, behind, waiting)
        return frame

    def latest(self, max_age_s: float, patience: float) -> Latest:
        """Returns the newest frame; waits only for the first one of a stream."""
        with self.changed:
            if self._newest is None:
                self._wait(lambda: self._newest is not None, patience)
            if self.ended is not None:
                raise self.ended
            if self._newest is None:
                raise self._silent(patience)
            frame, at = self._newest
            age = max(0.0, time.monotonic() - at)
            if age > max_age_s:
                raise StaleError(
                    f"{self.port}: the newest frame is {age:.3f} s old, allowed are {max_age_s:g} s; "
                    "does the finger still stream?"
                )
            new = bool(self._frames)
            skipped = max(0, len(self._frames) - 1)
            self._frames.clear()
            self._skipped += skipped
            self._given += new
            told = self._news(0.0)
        if told:
            self._tell(told, 0.0, 0)
        return Latest(frame, age, new, skipped)

    def end(self, error: TaxelError) -> None:
        """Ends the stream; the program gets the error after the last frame."""
        with self.changed:
            self.ended = error
            self.wake()

    def _wait(self, there: Callable[[], bool], timeout: float) -> None:
        self.changed.wait_for(lambda: there() or self.ended is not None, timeout)

    def _silent(self, timeout: float) -> LinkError:
        return LinkError(f"{self.port}: no frame for {timeout:g} s; is the stream on?")

    def _news(self, behind: float) -> list[str]:
        """Names what the program has not been told yet in this stream."""
        if not (self._lost or self._overflow or behind > BEHIND_S):
            return []
        facts = {"lost": self._lost > 0, "overflow": self._overflow > 0, "behind": behind > BEHIND_S}
        news = [name for name, true in facts.items() if true and name not in self._told]
        self._told.update(news)
        return news

    def _tell(self, news: list[str], behind: float, waiting: int) -> None:
        """Warns the program, outside the lock because a filter may turn a warning into an error."""
        mend = "use latest(), fewer fields or a lower rate"
        texts = {
            "lost": f"{self._lost} frames were lost on the link; `counts` has the number",
            "overflow": f"this program is too slow, {self._overflow} frames were dropped; {mend}",
            "behind": f"this program is {behind:.1f} s behind the finger, {waiting} frames wait; {mend}",
        }
        for name in news:
            warnings.warn(f"{self.port}: {texts[name]}", StreamWarning, stacklevel=5)

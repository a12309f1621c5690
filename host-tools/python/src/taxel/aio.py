"""Client of one finger for asyncio."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from types import TracebackType
from typing import Concatenate, ParamSpec, TypeVar

from .errors import LinkError
from .finger import Finger
from .messages import Frame
from .stream import Counts, Latest

P = ParamSpec("P")
R = TypeVar("R")

_SILENCE_S = 5.0


class AsyncFinger:
    """A finger whose frames and requests are awaited, so that the event loop never blocks.

    ::

        async with taxel.AsyncFinger() as finger:
            await finger.ask(Finger.set_rate, 500)
            async for frame in finger.frames(seconds=5):
                print(frame.time_s, frame.force)

    ``finger`` is the :class:`Finger` behind it, once it is open.
    """

    def __init__(self, port: str = "usb") -> None:
        self.port = port
        self.finger: Finger

    async def __aenter__(self) -> AsyncFinger:
        self.finger = await asyncio.to_thread(Finger, self.port)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await asyncio.to_thread(self.finger.close)

    async def ask(self, method: Callable[Concatenate[Finger, P], R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Calls a method of :class:`Finger` in a thread: ``await finger.ask(Finger.take_bias)``."""
        return await asyncio.to_thread(method, self.finger, *args, **kwargs)

    async def latest(self, max_age_s: float = 0.1) -> Latest:
        """Returns the newest frame, as :meth:`Finger.latest` does."""
        if self.counts.frames:
            return self.finger.latest(max_age_s)  # The first frame is here: this does not wait.
        return await asyncio.to_thread(self.finger.latest, max_age_s)

    @property
    def counts(self) -> Counts:
        """Counters of frames since the start of the stream."""
        return self.finger.counts

    async def frames(self, seconds: float | None = None) -> AsyncIterator[Frame]:
        """Yields the stream's frames, for ``seconds`` of device time or without end.

        A loop that falls behind, and lost frames, are said as by :meth:`Finger.frames`.
        """
        loop, arrived = asyncio.get_running_loop(), asyncio.Event()

        def wake() -> None:
            # The loop may be closed while the last bytes come in.
            if not loop.is_closed():
                loop.call_soon_threadsafe(arrived.set)

        stream = self.finger._stream
        await asyncio.to_thread(self.finger.stream, True)
        stream.wakers.append(wake)
        first: int | None = None
        try:
            while True:
                arrived.clear()
                frame = stream.poll()
                if frame is None:
                    await self._arrival(arrived)
                    continue
                first = frame.time_us if first is None else first
                if seconds is not None and frame.time_us - first >= seconds * 1e6:
                    return
                yield frame
        finally:
            stream.wakers.remove(wake)
            if stream.ended is None and stream.started:
                await asyncio.to_thread(self.finger.stream, False)

    async def _arrival(self, arrived: asyncio.Event) -> None:
        try:
            await asyncio.wait_for(arrived.wait(), _SILENCE_S)
        except asyncio.TimeoutError:
            raise LinkError(f"{self.port}: no frame for {_SILENCE_S:g} s; is the stream on?") from None

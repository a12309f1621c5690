"""Client of one finger."""

from __future__ import annotations

import random
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from .clock import HostTime
from .commands import CHUNK, Command, request
from .errors import LinkError, MalformedError, ProtocolError, RefusedError, TaxelError
from .messages import Fields, Frame, PointMethod
from .packets import Deframer, pack
from .ports import open_port
from .recorder import Recorder
from .replies import (
    BUSY,
    PROTOCOL,
    Bias,
    CalibrationChunk,
    Done,
    Info,
    Message,
    Rate,
    Refusal,
    Reply,
    Response,
    SelfTest,
    Version,
    decode,
)
from .stream import Counts, Latest, Stream
from .transport import Transport

R = TypeVar("R")

_PATIENCE = 0.5
_TRIES = 4
# Seconds within which the finger may erase its flash again.
_REST = 2.5
_PATIENCE_BEHIND = 15.0


class Finger:
    """A finger behind ``port``: a serial device, ``usb``, ``usb:SERIAL``, ``tcp:HOST:PORT`` or ``sim:SCENE``.

    ::

        with taxel.Finger() as finger:  # the only one on USB
            for frame in finger.frames(seconds=5):
                print(frame.time_s, frame.force)

    A thread reads the port, so that a slow loop over the frames loses none until
    :data:`taxel.stream.QUEUE` of them wait. Requests work while frames stream. All errors are
    :class:`TaxelError`.
    """

    def __init__(self, port: str = "usb", *, transport: Transport | None = None) -> None:
        self.port = port
        self._transport = transport or open_port(port)
        self._stream = Stream(port)
        self._changed = self._stream.changed
        self._replies: deque[Version | Reply] = deque()
        self._asking = threading.Lock()
        self._stop = False
        self._start_tag: int | None = None
        # A serial link keeps unread answers to a former host, which must not match this one's tags.
        self._tag = random.randrange(256)
        self._deframer = Deframer()
        self._reader = threading.Thread(target=self._read, name="taxel-reader", daemon=True)
        self._reader.start()
        try:
            self.version = self._ask_version()
        except TaxelError:
            self.close()
            raise

    def __enter__(self) -> Finger:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stops the stream and closes the port; a second call does nothing."""
        if self._stop:
            return
        if self._stream.started and self._stream.ended is None:
            try:
                self.stream(False)
            except TaxelError:
                pass  # A disconnected finger needs no stop.
        self._stop = True
        self._reader.join()
        self._transport.close()

    def frames(self, seconds: float | None = None) -> Iterator[Frame]:
        """Yields the stream's frames, for ``seconds`` of device time or without end.

        The loop starts the stream and stops it at its end. When the finger disconnects, the loop raises
        :class:`LinkError` after the last received frame. A loop that falls behind, and lost frames, are said
        by a :class:`StreamWarning`; :attr:`counts` has the numbers.
        """
        self.stream(True)
        first: int | None = None
        try:
            while True:
                frame = self.next_frame(timeout=5)
                first = frame.time_us if first is None else first
                if seconds is not None and frame.time_us - first >= seconds * 1e6:
                    return
                yield frame
        finally:
            if self._stream.ended is None and not self._stop:
                self.stream(False)

    def next_frame(self, timeout: float) -> Frame:
        """Returns the next frame of a started stream; waits at most ``timeout`` seconds."""
        return self._stream.next(timeout)

    def latest(self, max_age_s: float = 0.1) -> Latest:
        """Returns the newest frame at once, with its age; starts the stream if it is off.

        Frames in between are skipped and counted. It waits for the first frame of a stream only. Raises
        :class:`StaleError` if the newest frame is older than ``max_age_s``.
        """
        if not self._stream.started:
            self.stream(True)
        return self._stream.latest(max_age_s, 5)

    def host_time(self, frame: Frame) -> HostTime | None:
        """Returns the time of the frame's scan by the host's clocks; ``None`` in a stream's first second."""
        with self._changed:
            return self._stream.clock.host(frame.time_us)

    def record(self, path: str | Path, overwrite: bool = False) -> Recorder:
        """Opens a recorder of the stream, a context manager: ``with finger.record("press.csv"): …``.

        It writes all received frames with the fields that are set now, whatever the program takes of them.
        """
        return Recorder(self, path, overwrite)

    @property
    def counts(self) -> Counts:
        """Counters of frames since the start of the stream."""
        return self._stream.counts(self._deframer.bad_packets)

    def stream(self, on: bool) -> None:
        """Starts or stops the stream; frames from before the start are dropped."""
        self._expect(Done, Command.stream(on), starts=on)
        if not on:
            self._stream.started = False

    def info(self) -> Info:
        """Returns the finger's identity, settings and counters."""
        return self._expect(Info, Command.INFO)

    def set_rate(self, hz: int) -> float:
        """Sets the frames per second; returns the true rate, the scan rate over a whole number."""
        return self._expect(Rate, Command.set_rate(hz), what="rate").millihertz / 1000

    def set_filter(self, hz: int) -> None:
        """Sets the corner in Hz of the second-order low-pass on the signals; 0 turns it off."""
        self._expect(Done, Command.set_filter(hz), what="filter")

    def hold_row(self, row: int | None) -> None:
        """Holds an LED row (0 … 3) on in every step, to test the wiring; ``None`` scans again.

        Frames then carry codes and no estimate. It ends with the connection.
        """
        self._expect(Done, Command.hold_row(row))

    def set_fields(self, fields: Fields) -> None:
        """Selects the fields of the frames."""
        self._expect(Done, Command.set_fields(fields))

    def set_point_method(self, method: PointMethod) -> None:
        """Selects the method for the contact point."""
        self._expect(Done, Command.set_point_method(method))

    def take_bias(self, scans: int = 500) -> Bias:
        """Averages ``scans`` scans into a new bias; the finger rejects it while in motion."""
        averaging = max(0, scans) / max(1, self.info().scan_hz)
        # One try only, because a second one would be rejected as busy.
        patience = averaging + _TRIES * _PATIENCE
        return self._expect(Bias, Command.take_bias(scans), patience, 1, what="scans")

    def self_test(self, scans: int = 500) -> SelfTest:
        """Measures mean and noise of every channel over ``scans`` scans, at most 4096.

        The finger must be still; ``taxel self-test`` also judges the channels.
        """
        averaging = max(0, scans) / max(1, self.info().scan_hz)
        patience = averaging + _TRIES * _PATIENCE
        return self._expect(SelfTest, Command.self_test(scans), patience, 1, what="scans")

    def read_bias(self) -> Bias:
        """Returns the active bias."""
        return self._expect(Bias, Command.READ_BIAS)

    def clear_bias(self) -> None:
        """Restores the calibration's own bias."""
        self._expect(Done, Command.CLEAR_BIAS)

    def save_settings(self) -> None:
        """Saves scan, rate, filter, fields and method for the next power-up."""
        self._erase(Command.SAVE_SETTINGS)

    def save_bias(self) -> None:
        """Saves the active bias for the next power-up, until the calibration changes."""
        self._erase(Command.SAVE_BIAS)

    def upload_calibration(self, record: bytes) -> None:
        """Activates a calibration record after the finger has checked and stored it.

        The old record stays if the finger rejects the new one or the power fails.
        """
        self._erase(Command.calibration_begin(len(record)))
        for offset in range(0, len(record), CHUNK):
            self._expect(Done, Command.calibration_chunk(offset, record[offset : offset + CHUNK]))
        self._expect(Done, Command.CALIBRATION_COMMIT)

    def download_calibration(self) -> bytes:
        """Returns the active calibration record."""
        record = b""
        while True:
            chunk = self._expect(CalibrationChunk, Command.calibration_read(len(record)))
            record += chunk.data
            if len(chunk.data) < CHUNK:
                return record

    def _ask_version(self) -> Version:
        answer = self._exchange(Command.VERSION, _PATIENCE, _TRIES, False)
        if isinstance(answer, Reply):
            raise LinkError(f"{self.port}: busy; close the other program that has it open")
        if not isinstance(answer, Version):
            raise self._confused()
        if answer.protocol != PROTOCOL:
            firmware = ".".join(map(str, answer.firmware))
            raise ProtocolError(
                f"{self.port}: firmware {firmware} speaks protocol {answer.protocol}, this package "
                f"{PROTOCOL}; install the package that goes with it"
            )
        return answer

    def _erase(self, command: bytes) -> None:
        """Sends a request that erases flash, which the finger does at most once a second."""
        last = time.monotonic() + _REST
        while True:
            try:
                self._expect(Done, command)
            except RefusedError as error:
                if error.refusal.reason != BUSY or time.monotonic() > last:
                    raise
                time.sleep(_REST / 50)
            else:
                return

    def _expect(
        self,
        kind: type[R],
        command: bytes,
        patience: float = _PATIENCE,
        tries: int = _TRIES,
        starts: bool = False,
        what: str | None = None,
    ) -> R:
        answer = self._exchange(command, patience, tries, starts)
        result: Response | Refusal | None = answer.result if isinstance(answer, Reply) else None
        if isinstance(result, Refusal):
            named = result if what is None else f"{what}: {result}"
            raise RefusedError(f"{self.port}: {named}", result)
        if not isinstance(result, kind):
            raise self._confused()
        return result

    def _exchange(self, command: bytes, patience: float, tries: int, starts: bool) -> Version | Reply:
        with self._asking:
            self._tag = (self._tag + 1) % 256
            tag = self._tag
            if starts:
                self._start_tag = tag
            # The first zero ends half a packet that the finger may still hold.
            packet = b"\0" + pack(request(tag, command))
            first = time.monotonic()
            for _ in range(tries):
                asked = time.monotonic()
                self._transport.write(packet)
                answer = self._answer(tag, command == Command.VERSION, asked + patience)
                if answer is not None:
                    with self._changed:
                        self._stream.clock.echo(time.monotonic() - asked)
                    return answer
            # The reply may be behind frames that this program has not read yet.
            while self._stream.is_live() and time.monotonic() - first < _PATIENCE_BEHIND:
                answer = self._answer(tag, command == Command.VERSION, time.monotonic() + _PATIENCE)
                if answer is not None:
                    return answer
        raise LinkError(f"{self.port}: nobody answers; is it a finger, and is its firmware running?")

    def _answer(self, tag: int, version: bool, deadline: float) -> Version | Reply | None:
        with self._changed:
            while True:
                while self._replies:
                    reply = self._replies.popleft()
                    # A TCP port that serves another program refuses even the version.
                    refused = isinstance(reply, Reply) and isinstance(reply.result, Refusal)
                    fits = isinstance(reply, Version) == version or version and refused
                    if reply.tag == tag and fits:
                        return reply
                if self._stream.ended is not None:
                    raise self._stream.ended
                left = deadline - time.monotonic()
                if left <= 0:
                    return None
                self._changed.wait(left)

    def _confused(self) -> LinkError:
        return LinkError(f"{self.port}: the answer belongs to another request; ask again")

    def _read(self) -> None:
        try:
            while not self._stop:
                received = self._transport.read()
                at = time.monotonic()
                # Decoded outside the lock, so that latest() waits for no decoding.
                messages = [self._decoded(message) for message in self._deframer.push(received)]
                if messages:
                    with self._changed:
                        for message in messages:
                            self._take(message, at)
                        self._stream.wake()
        except TaxelError as error:
            self._stream.end(error)

    def _decoded(self, message: bytes) -> Message | None:
        try:
            return decode(message)
        except MalformedError:
            self._deframer.bad_packets += 1
            return None

    def _take(self, decoded: Message | None, at: float) -> None:
        if decoded is None:
            return
        if not isinstance(decoded, Frame):
            if decoded.tag == self._start_tag and isinstance(decoded, Reply):
                self._start_tag = None
                self._stream.start()
            self._replies.append(decoded)
        else:
            self._stream.push(decoded, at)

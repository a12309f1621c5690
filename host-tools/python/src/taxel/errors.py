"""Errors in one line each: what happened, and how to mend it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .replies import Refusal


class TaxelError(Exception):
    """Base of all errors of this package."""


class MissingFieldError(TaxelError):
    """The frame does not carry a field that a computation needs."""


class RecordingError(TaxelError):
    """A recording cannot be read or written."""


class MalformedError(TaxelError):
    """Bytes that are no message of this protocol."""


class LinkError(TaxelError):
    """The port cannot be opened, no finger answers, or the finger is disconnected."""


class StaleError(LinkError):
    """The newest frame is older than the program allows."""


class ProtocolError(TaxelError):
    """The finger speaks another version of the protocol."""


class RefusedError(TaxelError):
    """The finger rejected a valid request; ``refusal`` holds the reason."""

    def __init__(self, message: str, refusal: Refusal) -> None:
        super().__init__(message)
        self.refusal = refusal


class StreamWarning(UserWarning):
    """Frames were lost or dropped, or the program falls behind; said once a stream for each of these."""

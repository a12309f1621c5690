"""What can go wrong, one line each: what happened, and how to mend it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .messages import Refusal


class TaxelError(Exception):
    """Whatever this package raises."""


class MalformedError(TaxelError):
    """Bytes that are no message of this protocol."""


class LinkError(TaxelError):
    """The port cannot be opened, nobody answers, or the finger has gone."""


class ProtocolError(TaxelError):
    """The finger speaks another version of the protocol."""


class RefusedError(TaxelError):
    """The finger understood, and declined. ``refusal`` says why."""

    def __init__(self, message: str, refusal: Refusal) -> None:
        super().__init__(message)
        self.refusal = refusal

"""Client of the taxel robot fingertip: newtons, millimetres, or the reason for a missing value.

It follows docs/protocol.md alone. :class:`Finger` connects to a finger; :func:`read_frames` reads recorded
bytes.
"""

from collections.abc import Iterable, Iterator

from .errors import LinkError, MalformedError, ProtocolError, RefusedError, TaxelError
from .finger import Counts, Finger
from .messages import (
    Bias,
    Codes,
    Contact,
    Fields,
    Force,
    Frame,
    Info,
    NoValue,
    Point,
    PointMethod,
    Signals,
    Slip,
    Status,
    Uncertainty,
)
from .messages import decode as _decode
from .packets import Deframer as _Deframer
from .table import columns, data_frame

__all__ = [
    "Bias",
    "Codes",
    "Contact",
    "Counts",
    "Fields",
    "Finger",
    "Force",
    "Frame",
    "Info",
    "LinkError",
    "MalformedError",
    "NoValue",
    "Point",
    "PointMethod",
    "ProtocolError",
    "RefusedError",
    "Signals",
    "Slip",
    "Status",
    "TaxelError",
    "Uncertainty",
    "columns",
    "data_frame",
    "read_frames",
]


def read_frames(received: Iterable[bytes]) -> Iterator[Frame]:
    """Yields the frames in bytes from the wire, which may come in pieces of any length.

    Damaged packets and messages other than frames are skipped.
    """
    deframer = _Deframer()
    for piece in received:
        for message in deframer.push(piece):
            try:
                decoded = _decode(message)
            except MalformedError:
                continue
            if isinstance(decoded, Frame):
                yield decoded

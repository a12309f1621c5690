"""Client of the taxel robot fingertip: newtons, millimetres, or the reason for a missing value.

It follows docs/protocol.md alone. :class:`Finger` connects to a finger; :func:`read_frames` reads recorded
bytes.
"""

from collections.abc import Iterable, Iterator

from .aio import AsyncFinger
from .clock import HostTime
from .errors import (
    LinkError,
    MalformedError,
    MissingFieldError,
    ProtocolError,
    RecordingError,
    RefusedError,
    StaleError,
    StreamWarning,
    TaxelError,
)
from .finger import Finger
from .messages import (
    Codes,
    Contact,
    Fields,
    Force,
    Frame,
    NoValue,
    Point,
    PointMethod,
    Signals,
    Slip,
    Status,
    Uncertainty,
)
from .packets import Deframer as _Deframer
from .ports import Found, fingers
from .recorder import Recorder
from .recordings import Recording, read
from .replies import Bias, Channel, Info, SelfTest
from .replies import decode as _decode
from .stream import Counts, Latest
from .table import columns, data_frame
from .wrench import Wrench, wrench

__all__ = [
    "AsyncFinger",
    "Bias",
    "Channel",
    "Codes",
    "Contact",
    "Counts",
    "Fields",
    "Finger",
    "Force",
    "Found",
    "Frame",
    "HostTime",
    "Info",
    "Latest",
    "LinkError",
    "MalformedError",
    "MissingFieldError",
    "NoValue",
    "Point",
    "PointMethod",
    "ProtocolError",
    "Recorder",
    "Recording",
    "RecordingError",
    "RefusedError",
    "SelfTest",
    "Signals",
    "Slip",
    "StaleError",
    "Status",
    "StreamWarning",
    "TaxelError",
    "Uncertainty",
    "Wrench",
    "columns",
    "data_frame",
    "fingers",
    "read",
    "read_frames",
    "wrench",
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

"""Six-axis wrench of a frame: force, and moment about a chosen origin."""

from __future__ import annotations

from typing import NamedTuple

from .errors import MissingFieldError
from .messages import Frame, NoValue, Point


class Wrench(NamedTuple):
    """Force in newtons and moment in newton millimetres, along the finger's axes."""

    fx_n: float
    fy_n: float
    fz_n: float
    mx_nmm: float
    my_nmm: float
    mz_nmm: float


def wrench(frame: Frame, origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Wrench | NoValue:
    """Returns the wrench about ``origin_mm``, by default the middle of the pad at the skin's surface.

    The contact point lies on the surface of a flat pad, z = 0; torsion is the contact's moment about its
    normal. A part without a value gives its reason. Raises :class:`MissingFieldError` for a frame without
    the fields ``FORCE``, ``POINT`` and ``TORSION``.
    """
    force, point, torsion = frame.force, frame.point, frame.torsion_nmm
    if force is None or point is None or torsion is None:
        parts = {"FORCE": force, "POINT": point, "TORSION": torsion}
        lacking = " and ".join(name for name, part in parts.items() if part is None)
        raise MissingFieldError(
            f"frame {frame.seq}: a wrench needs the field {lacking}; "
            "set_fields(Fields.FORCE | Fields.POINT | Fields.TORSION)"
        )
    fx, fy, fz = force
    for part in (fx, fy, fz):
        if isinstance(part, NoValue):
            return part
    assert not isinstance(fx, NoValue) and not isinstance(fy, NoValue) and not isinstance(fz, NoValue)
    if fx == fy == fz == 0 and not frame.in_contact:
        return Wrench(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if not isinstance(point, Point):
        return point
    if isinstance(torsion, NoValue):
        return torsion
    x, y, z = point.x_mm - origin_mm[0], point.y_mm - origin_mm[1], -origin_mm[2]
    return Wrench(fx, fy, fz, y * fz - z * fy, z * fx - x * fz, x * fy - y * fx + torsion)

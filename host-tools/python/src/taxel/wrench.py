"""Six-axis wrench of a frame: force, and moment about a chosen origin, along chosen axes."""

from __future__ import annotations

from math import cos, radians, sin
from typing import NamedTuple

from .errors import MissingFieldError
from .messages import Frame, NoValue, Point


class Wrench(NamedTuple):
    """Force in newtons and moment in newton millimetres, by default along the finger's axes."""

    fx_n: float
    fy_n: float
    fz_n: float
    mx_nmm: float
    my_nmm: float
    mz_nmm: float


def wrench(
    frame: Frame,
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Wrench | NoValue:
    """Returns the wrench about ``origin_mm``, by default the middle of the pad at the skin's surface.

    Its axes are the finger's, turned by roll, pitch and yaw about the finger's fixed x, y and z axes, as in
    URDF. Both are the pose of a tool in the finger's frame: ``wrench(frame, (x, y, z), (roll, pitch, yaw))``
    is that of ``taxel bridge --zenoh --tool x,y,z,roll,pitch,yaw``.

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
    moment = (y * fz - z * fy, z * fx - x * fz, x * fy - y * fx + torsion)
    if any(rpy_deg):
        axes = _axes(*map(radians, rpy_deg))
        (fx, fy, fz), moment = _along(axes, (fx, fy, fz)), _along(axes, moment)
    return Wrench(fx, fy, fz, *moment)


_Vector = tuple[float, float, float]


def _axes(roll: float, pitch: float, yaw: float) -> tuple[_Vector, _Vector, _Vector]:
    """Returns the unit vectors of the turned x, y and z axes."""
    sr, cr, sp, cp, sy, cy = sin(roll), cos(roll), sin(pitch), cos(pitch), sin(yaw), cos(yaw)
    return (
        (cy * cp, sy * cp, -sp),
        (cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr),
        (cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr),
    )


def _along(axes: tuple[_Vector, _Vector, _Vector], vector: _Vector) -> _Vector:
    x, y, z = vector
    one, two, three = (a * x + b * y + c * z for a, b, c in axes)
    return one, two, three

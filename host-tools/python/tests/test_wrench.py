"""Tests of the six-axis wrench."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fingers import CALIBRATION, replayed, rows, serve
from test_stream import frame

from taxel import Fields, Finger, Force, MissingFieldError, NoValue, Point, Status, Wrench, wrench

PRESSED = frame(1)._replace(
    status=Status.CONTACT, force=Force(0.5, -0.25, 2.0), point=Point(3.0, -1.0), torsion_nmm=0.125
)


def test_moment_is_about_the_middle_of_the_pad():
    # r × F for r = (3, -1, 0) mm, and the torsion about z.
    assert wrench(PRESSED) == Wrench(0.5, -0.25, 2.0, -2.0, -6.0, 3 * -0.25 + 0.5 + 0.125)


def test_moment_about_the_contact_is_its_torsion():
    assert wrench(PRESSED, (3.0, -1.0, 0.0)) == Wrench(0.5, -0.25, 2.0, 0.0, 0.0, 0.125)


def test_origin_below_the_skin_gives_shear_an_arm():
    about = wrench(PRESSED, (3.0, -1.0, -10.0))
    assert isinstance(about, Wrench)
    assert about[3:] == pytest.approx((2.5, 5.0, 0.125))


def test_turned_axes_are_those_of_a_yaw_of_90_degrees():
    # The tool's x axis is the finger's y, and its y axis the finger's x backwards.
    turned = wrench(PRESSED, (3.0, -1.0, 0.0), (0.0, 0.0, 90.0))
    assert turned == pytest.approx((-0.25, -0.5, 2.0, 0.0, 0.0, 0.125))


def pose(origin: tuple[float, ...], rpy_deg: tuple[float, ...]) -> Any:
    """Returns a tool's pose as a matrix of 4 by 4: roll, then pitch, then yaw about the fixed axes."""
    matrix = np.eye(4)
    for degrees, (i, j) in zip(rpy_deg, ((1, 2), (2, 0), (0, 1)), strict=True):
        turn = np.eye(4)
        turn[i, i] = turn[j, j] = np.cos(np.radians(degrees))
        turn[j, i] = np.sin(np.radians(degrees))
        turn[i, j] = -turn[j, i]
        matrix = turn @ matrix
    matrix[:3, 3] = origin
    return matrix


@pytest.mark.parametrize(
    ("origin", "rpy_deg"),
    [((5, -10, 20), (40, -25, 110)), ((0, 0, -25), (0, 0, 90)), ((1, 2, 3), (-170, 80, 5))],
)
def test_wrench_in_a_tool_frame_is_that_of_forces_at_points(origin: Any, rpy_deg: Any):
    """The force acts at the contact, the torsion as a couple of forces beside it."""
    at = np.array([3.0, -1.0, 0.0])
    aside = np.array([0.5, 0.0, 0.0])
    forces = [(at, (0.5, -0.25, 2.0)), (at + aside, (0, 0.125, 0)), (at - aside, (0, -0.125, 0))]
    back = np.linalg.inv(pose(origin, rpy_deg))
    total = np.zeros(6)
    for point, force in forces:
        place, along = (back @ [*point, 1])[:3], (back @ [*force, 0])[:3]
        total += np.concatenate([along, np.cross(place, along)])
    assert wrench(PRESSED, origin, rpy_deg) == pytest.approx(total, abs=1e-12)


def test_wrench_in_a_tilted_tool_frame_is_the_simulated_truth(command: str, tmp_path: Path):
    trace, _ = replayed(command, "torsion", tmp_path)
    truth = {int(row["t_us"]): row for row in rows(trace) if row["x_mm"]}
    origin, rpy_deg = (5.0, -10.0, 20.0), (40.0, -25.0, 110.0)
    back = np.linalg.inv(pose(origin, rpy_deg))
    more = ["--calibration", str(CALIBRATION), "--tcp", "127.0.0.1:0"]
    errors = []
    with serve(command, f"file:{trace}", *more) as port, Finger(port) as finger:
        finger.set_fields(Fields.FORCE | Fields.POINT | Fields.TORSION)
        for each in finger.frames(seconds=3):
            row, ours = truth.get(each.time_us), wrench(each, origin, rpy_deg)
            if row is not None and isinstance(ours, Wrench):
                force = (back @ [*(float(row[name]) for name in ("fx_n", "fy_n", "fz_n")), 0])[:3]
                place = (back @ [float(row["x_mm"]), float(row["y_mm"]), 0, 1])[:3]
                torsion = (back @ [0, 0, float(row["torsion_nmm"]), 0])[:3]
                errors.append(np.subtract(ours, [*force, *(np.cross(place, force) + torsion)]))
    off = np.abs(errors).max(axis=0)
    print(f"{len(errors)} wrenches, off by {off[:3].max():.4f} N and {off[3:].max():.3f} N mm at most")
    assert len(errors) > 1000
    assert off[:3].max() < 0.02 and off[3:].max() < 0.3


def test_unloaded_finger_has_zero_wrench():
    idle = PRESSED._replace(
        status=Status(0), force=Force(0.0, 0.0, 0.0), point=NoValue.NO_CONTACT, torsion_nmm=NoValue.NO_CONTACT
    )
    assert wrench(idle) == Wrench(0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize("part", ["force", "point", "torsion_nmm"])
def test_part_without_value_gives_its_reason(part: str):
    reason = NoValue.SATURATED
    value = Force(0.1, reason, 1.0) if part == "force" else reason
    assert wrench(PRESSED._replace(**{part: value})) is reason


def test_frame_without_the_fields_is_an_error_that_names_them():
    lacking = PRESSED._replace(point=None, torsion_nmm=None)
    with pytest.raises(MissingFieldError, match="needs the field POINT and TORSION; set_fields"):
        wrench(lacking)

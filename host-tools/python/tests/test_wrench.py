"""Tests of the six-axis wrench."""

import pytest
from test_stream import frame

from taxel import Force, MissingFieldError, NoValue, Point, Status, Wrench, wrench

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

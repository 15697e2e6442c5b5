"""Observations: an array that cannot be used is named, in one line."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_nmm.observation import WIDTHS, Observation
from tests.cases import refused


def two_bodies():
    shapes = {name: (2, width) if width else (2,) for name, width in WIDTHS.items()}
    return Observation(**{name: np.zeros(shape) for name, shape in shapes.items()})


def bad_values():
    bad = []
    for name, values in vars(two_bodies()).items():
        nan, infinite = values.copy(), values.copy()
        nan.flat[-1], infinite.flat[0] = np.nan, np.inf
        of_other_shapes = values[:1], values[None], 0.0, [[1.0], [1.0, 2.0]]
        no_numbers = values.astype(str), values.astype(complex), "much", None
        for value in (nan, infinite, *of_other_shapes, *no_numbers):
            bad.append((name, value))
    return bad


@pytest.mark.parametrize(("name", "value"), bad_values())
def test_an_array_that_cannot_be_used_is_named(name, value):
    good = two_bodies()
    good.checked(2)
    with refused(rf"^observation\.{name}(\.shape|\[[0-9, ]+\])?: "):
        replace(good, **{name: value}).checked(2)


@pytest.mark.parametrize("value", [2, -1, 0.5])
def test_a_contact_says_whether_not_how_many_and_bodies_are_counted(value):
    contacts = np.array([[0.0, 1.0], [1.0, value]])
    with refused(rf"^observation\.contact: {value}.* 0 or 1: whether"):
        replace(two_bodies(), contact=contacts).checked(2)
    with refused(r"^observation\.joint_rad\.shape: \(2, 6\) .* \[3, 6\]$"):
        two_bodies().checked(3)


@pytest.mark.parametrize(
    ("name", "value"), [("trunk_rad", 1e8), ("com_speed_mps", -1e300)]
)
def test_a_number_of_no_body_is_refused(name, value):
    """A sine of 1e8 is noise in float32, and 1e300 is infinity there: torques were NaN."""
    with refused(rf"^observation\.{name}: .*finite numbers, from -1"):
        replace(two_bodies(), **{name: [0.0, value]}).checked(2)

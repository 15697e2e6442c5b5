"""Errors of arrays name the place of what is no number."""

import numpy as np
import pytest

from storage.inputs import checks
from tests.cases import refused


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ([1.0, "0,92"], r"x\[1\]: '0,92'"),
        (np.array(["1.5", "2"]), r"x\[0\]: '1.5'"),
        ([[1.0, 2.0], [3.0, "much"]], r"x\[1, 1\]: 'much'"),
        ("much", "x: 'much'"),
        (np.array(["2026-05-04"], "M8[s]"), r"x\[0\]: '2026-05-04"),
        ([1.0, 10**400], r"x\[1\]: 1000"),
        ([[1.0], [1.0, 2.0]], r"x\[0\]: \[1.0\]"),
    ],
)
def test_what_is_no_number_is_named_by_its_place(values, said):
    with refused(f"^{said}.* cannot be used; allowed: an array of numbers"):
        checks.numbers("x", values)


def test_gaps_and_flags_are_numbers():
    assert np.isnan(checks.numbers("x", [1.0, None])[1])
    assert checks.numbers("x", [True, False]).tolist() == [1.0, 0.0]

"""The text of a selection: what it means, and what is refused."""

import numpy as np
import pytest

from storage.inputs.errors import InputError
from study.explore.store_view import read_selection, selected
from tests.cases import asset

COLUMNS = ("speed", "phi_printed")


def test_a_text_and_its_ranges():
    ranges = read_selection(" speed -0.5..1.25,phi_printed 1e1..Infinity, ", COLUMNS)
    assert ranges == {"speed": (-0.5, 1.25), "phi_printed": (10.0, np.inf)}
    assert read_selection("", COLUMNS) == {}
    values = {"speed": np.array([0.0, 1.0, 2.0, np.nan]), "phi_printed": np.arange(4.0)}
    inside = selected(
        {"speed": (0.0, 1.0), "phi_printed": (1.0, np.inf)}, values.__getitem__, 4
    )
    assert inside.tolist() == [False, True, False, False]
    assert selected({}, values.__getitem__, 4).all()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (text, named)
        for named, texts in asset("refused-selections.toml").items()
        for text in texts
    ],
)
def test_what_is_no_selection(text, named):
    with pytest.raises(InputError, match=named):
        read_selection(text, COLUMNS)

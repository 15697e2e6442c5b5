"""How arms are drawn; labels that do not overlap."""

import numpy as np
import pytest
from matplotlib.text import Annotation

from study.experiment.arms import ARMS
from study.pictures import style
from study.report.axes import LABEL_SPACING_PT, End, Look, label_ends, looks, spread_out, trial_axis
from study.report.runs import Results
from tests.study.report.synthetic import arm


def test_looks_tell_arms_apart_and_three_stand_in_front(results: Results) -> None:
    for arms in (results.arms, {name: arm(name, [1, 2]) for name in ARMS}):
        found = looks(arms)
        assert len({(look.colour, look.marker) for look in found.values()}) == len(arms)
        assert all(look.label == ARMS[name].label for name, look in found.items())
        assert list(found) == list(arms)
        assert len({look.label for look in found.values()}) == len(arms)
    front = {name for name, look in looks(results.arms).items() if look.front}
    assert front == {"dog", "best", "cmaes-warm"}


@pytest.mark.parametrize(("places", "apart", "high", "expected"), [
    ([0.0, 10.0, 20.0], 5.0, 100.0, [0.0, 10.0, 20.0]), ([10.0, 10.0], 4.0, 100.0, [8.0, 12.0]),
    ([0.0, 0.0, 0.0], 4.0, 100.0, [0.0, 4.0, 8.0]), ([99.0, 100.0], 4.0, 100.0, [96.0, 100.0]),
    ([], 4.0, 1.0, []),
])  # fmt: skip
def test_spread_out(places: list[float], apart: float, high: float, expected: list[float]) -> None:
    assert spread_out(places, apart, 0.0, high) == expected


def test_places_that_do_not_fit_stay_apart_all_the_same() -> None:
    places = spread_out(np.linspace(0.0, 10.0, 14).tolist(), 4.0, 0.0, 10.0)
    assert np.diff(places).min() >= 4.0 - 1e-9


@pytest.mark.slow
def test_labels_of_lines_with_one_end_do_not_overlap() -> None:
    figure = style.new_figure(6.0, 4.0)
    axes = figure.add_axes((0.1, 0.1, 0.6, 0.8))
    trial_axis(axes, 100)
    look = Look("x", "#000000", "#000000", "solid", "o", False)
    label_ends(axes, [End(1.0, look, f"arm {rank}", rank) for rank in range(14)], 100.0)
    figure.canvas.draw()
    labels = [text for text in axes.texts if isinstance(text, Annotation)]
    assert len(labels) == 14
    boxes = sorted((label.get_window_extent().y0, label.get_text()) for label in labels)
    assert [text for _, text in boxes] == [f"arm {rank}" for rank in range(14)]
    assert np.diff([y for y, _ in boxes]).min() >= LABEL_SPACING_PT * figure.dpi / 72 - 0.5

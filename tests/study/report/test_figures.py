"""Figures: how arms are drawn, dots that are all there, labels within the figure; whole reports."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from study.experiment.arms import ARMS
from study.pictures import style
from study.report import figures
from study.report.figures import looks, spread_out, write_report
from study.report.runs import read_results
from taichi_nmm import InputError
from tests.cases import cases, refused
from tests.study.report import synthetic
from tests.study.report.synthetic import arm, counted


def test_looks_tell_arms_apart_and_three_stand_in_front(results):
    for arms in (results.arms, {name: arm(name, [1, 2]) for name in ARMS}):
        found = looks(arms)
        assert len({(look.colour, look.marker) for look in found.values()}) == len(arms)
        assert len({look.colour for look in found.values()}) == len(arms)
        assert all(look.label == ARMS[name].label for name, look in found.items())
        assert list(found) == list(arms)
        assert len({look.label for look in found.values()}) == len(arms)
    front = {name for name, look in looks(results.arms).items() if look.front}
    assert front == {"dog", "worlds", "cmaes-warm"}


@cases("spread-labels.toml", "places", "apart", "high", "expected")
def test_spread_out(places, apart, high, expected):
    assert spread_out(places, apart, 0.0, high) == expected


def test_places_that_do_not_fit_stay_apart_all_the_same():
    places = spread_out(np.linspace(0.0, 10.0, 14).tolist(), 4.0, 0.0, 10.0)
    assert np.diff(places).min() >= 4.0 - 1e-9


def test_every_run_has_a_dot_of_its_own():
    places = np.sort(np.random.default_rng(1).choice([0.0, 0.15, 0.151, 0.8], 50))
    x, y = figures.piles(places)
    assert len({(round(a, 4), round(b, 4)) for a, b in zip(x, y, strict=True)}) == 50
    assert np.abs(y).max() < 0.5
    assert np.abs(x - places).max() < 0.1
    none = figures.piles(np.empty(0))
    assert len(none[0]) == len(none[1]) == 0


@pytest.mark.slow
def test_figures_are_written_twice_alike(tmp_path, monkeypatch):
    monkeypatch.setattr(style, "PNG_DPI", 80)
    arms = {"dog": (0.1, 0.01), "random": (0.0, 0.0), "worlds-stairs": (0.9, 0.0)}
    results = read_results(synthetic.write(tmp_path / "data", arms, 6, 12, "walking"))
    for write in (figures.write_best_cost, figures.write_first_walker):
        first, second = (write(tmp_path / name, results) for name in ("1.png", "2.png"))
        assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize(
    ("cost", "sign", "scale"),
    [
        ("smooth", 1, "log"),
        ("walking", 1, "linear"),
        ("weighted", 1, "log"),
        ("weighted", -1, "linear"),
        ("front", -1, "linear"),
    ],
)
def test_costs_have_the_axis_of_their_kind(cost, sign, scale, results, monkeypatch):
    """The line below which all walk to the end is that of the walking cost alone."""
    seen = []
    monkeypatch.setattr(style, "save_png", lambda figure, *_: seen.append(figure))
    arms = {
        name: replace(arm, best=sign * arm.best) for name, arm in results.arms.items()
    }
    figures.write_best_cost(Path(), replace(results, cost=cost, arms=arms))
    (axes,) = seen[0].axes
    levels = [np.asarray(line.get_ydata())[0] for line in axes.lines]
    assert axes.get_yscale() == scale
    assert (figures.WALKS_BELOW in levels) == (cost == "walking")


@pytest.mark.slow
def test_labels_stay_within_the_figure(tmp_path, monkeypatch):
    """Those of all arms fit right of the lines; of lines with one end they stay apart, by rank."""
    results = counted(*(arm(name, [3, 17, np.inf]) for name in ARMS))
    seen = []
    monkeypatch.setattr(style, "save_png", lambda figure, *_: seen.append(figure))
    figures.write_best_cost(tmp_path / "1.png", results)
    figures.write_first_walker(tmp_path / "2.png", results)
    texts = [
        (figure, text) for figure in seen for axes in figure.axes for text in axes.texts
    ]
    assert len(texts) > 2 * len(results.arms)
    for figure, text in texts:
        box = text.get_window_extent()
        assert box.x0 >= 0 and box.x1 <= figure.bbox.width, text.get_text()
    labels = [text for figure, text in texts if figure is seen[0]]
    boxes = sorted((label.get_window_extent().y0, label.get_text()) for label in labels)
    assert [text.rpartition(" ")[0] for _, text in boxes] == [
        arm.label for arm in ARMS.values()
    ]
    assert (
        np.diff([y for y, _ in boxes]).min()
        >= figures.LABEL_SPACING_PT * seen[0].dpi / 72 - 0.5
    )


# A report is written whole or not at all.

LONE = counted(arm("random", [np.inf], trials=2))


def test_a_single_arm_of_a_single_run_is_reported(tmp_path):
    write_report(replace(LONE, folder=tmp_path), {})
    assert (
        "| 1 | 0 | 0 to 79 | > 2 |" in (tmp_path / "report" / "report.md").read_text()
    )


def test_a_failed_report_changes_nothing(tmp_path, monkeypatch):
    def fails(path, results):
        path.touch()
        raise InputError("disk", "full", "space")

    monkeypatch.setattr(figures, "write_best_cost", fails)
    older = tmp_path / "report" / "report.md"
    older.parent.mkdir()
    older.write_text("an older one")
    with refused("disk"):
        write_report(replace(LONE, folder=tmp_path), {})
    assert [*older.parent.iterdir()] == [older] and older.read_text() == "an older one"

"""Figures: dots that are all there, labels within the figure, files that are whole."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from study.experiment.arms import ARMS
from study.pictures import style
from study.report import figures
from study.report.runs import read_results
from tests.study.report import synthetic
from tests.study.report.synthetic import arm, counted

pytestmark = pytest.mark.slow


def test_every_run_has_a_dot_of_its_own() -> None:
    places = np.sort(np.random.default_rng(1).choice([0.0, 0.15, 0.151, 0.8], 50))
    x, y = figures.piles(places)
    assert len({(round(a, 4), round(b, 4)) for a, b in zip(x, y, strict=True)}) == 50
    assert np.abs(y).max() < 0.5
    assert np.abs(x - places).max() < 0.1
    none = figures.piles(np.empty(0))
    assert len(none[0]) == len(none[1]) == 0


def test_figures_are_written_twice_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, "PNG_DPI", 80)
    arms = {"dog": (0.1, 0.01), "random": (0.0, 0.0), "best": (0.9, 0.0)}
    results = read_results(synthetic.write(tmp_path / "data", arms, 6, 12, "walking"))
    names = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        files = figures.write_best_cost(folder, results)
        files += figures.write_walkers(folder, results)
        files += figures.write_first_walker(folder, results)
        names = [file.name for file in files]
        assert sorted(names) == sorted(file.name for file in folder.iterdir())
    assert len(names) == 6
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_labels_stay_within_the_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names and numbers of all arms fit right of the lines."""
    results = counted(*(arm(name, [3, 17, np.inf]) for name in ARMS))
    seen: list[Figure] = []
    monkeypatch.setattr(figures, "save", lambda figure, *_: seen.append(figure))
    figures.write_walkers(tmp_path, results)
    figures.write_best_cost(tmp_path, results)
    figures.write_first_walker(tmp_path, results)
    texts = [(figure, text) for figure in seen for axes in figure.axes for text in axes.texts]
    assert len(texts) > 3 * len(results.arms)
    for figure, text in texts:
        box = text.get_window_extent()
        assert box.x0 >= 0 and box.x1 <= figure.bbox.width, text.get_text()

"""Signals of the page: as the command records them, and people in their units."""

from concurrent.futures import Future
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from bokeh.models import CustomJS

from study.experiment.gains import gains_of_source
from study.explore import signals as of_signals
from study.explore.server import Message
from study.explore.signals import MOST, Signals, label
from study.explore.walk import chosen_setting, recorded, walk
from study.explore.words import CHOICES
from study.pictures.gait_cycle import PANELS
from study.pictures.trajectory_files import OWN_COLUMNS, own_columns
from taichi_nmm.result import MUSCLES
from tests.study import synthetic_gait
from tests.study.explore.test_walk import LEVEL

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def reference():
    """On level ground, on which it walks enough strides."""
    return walk(gains_of_source("reference"), chosen_setting(**LEVEL))


def at_once(function, *arguments):
    """What an executor promises, kept."""
    future = Future[Any]()
    future.set_result(function(*arguments))
    return future


@pytest.fixture
def signals():
    """In a tab and with an executor that do all at once."""
    both = Mock(submit=at_once, add_next_tick_callback=lambda task: task())
    return Signals(both, both, Message("message"), script=CustomJS())


def drawn(signals, curve, name):
    """A curve of a plot, which is found by the name of its column."""
    shown = [plot for plot in signals.plots if plot.figure.visible]
    (plot,) = [plot for plot in shown if name in plot.figure.tags]
    assert plot.figure.title.text == label(name)
    return dict(plot.sources[curve].data)


def choose(signals, *names, over=0):
    signals.over.active = over
    signals.names.value = list(names)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("l_SOL_force_n", "left soleus force (N): l_SOL_force_n"),
        ("r_knee_flexion_rad", "right knee flexion (rad): r_knee_flexion_rad"),
        ("hat_radps", "hat (rad/s): hat_radps"),
        ("l_hip_extension_power_w", "left hip extension power (W)"),
    ],
)
def test_a_column_is_called_by_words_and_by_its_name(name, words):
    assert label(name).startswith(words)


def test_a_signal_is_a_column_of_the_command_s_recording(reference, signals):
    columns = own_columns(recorded(reference, 0)[0])
    assert [*columns] == ["time_s", *OWN_COLUMNS]
    signals.show(reference, None)
    for start in range(0, len(OWN_COLUMNS), MOST):
        choose(signals, *OWN_COLUMNS[start : start + MOST])
        for name in signals.names.value:
            curve = drawn(signals, "signal", name)
            np.testing.assert_array_equal(curve["x"], columns["time_s"])
            np.testing.assert_array_equal(curve["y"], columns[name])
            assert len(drawn(signals, "beside", name)["x"]) == 0


def test_another_gait_is_drawn_beside(reference, signals):
    published = walk(gains_of_source("published"), reference.experiment)
    signals.show(published, reference)
    choose(signals, "l_ground_z_n")
    force = own_columns(recorded(reference, 0)[0])["l_ground_z_n"]
    np.testing.assert_array_equal(drawn(signals, "beside", "l_ground_z_n")["y"], force)
    kept = drawn(signals, "signal", "l_ground_z_n")["y"]
    assert not np.array_equal(kept, force)
    signals.show(reference, None)
    np.testing.assert_array_equal(drawn(signals, "signal", "l_ground_z_n")["y"], force)
    assert len(drawn(signals, "beside", "l_ground_z_n")["y"]) == 0


@pytest.mark.parametrize("side", "lr")
def test_who_walks_as_people_do_is_drawn_upon_them(
    reference, signals, side, monkeypatch
):
    """Signs, units and strides, of each column that people have."""
    alike = replace(reference, trajectory=synthetic_gait.walk(12.0, 200.0))
    monkeypatch.setattr(of_signals, "recorded", lambda walk, n: (walk.trajectory, n))
    signals.show(alike, None)
    muscles = {f"{muscle}_activation": (muscle, 1.0) for muscle in MUSCLES}
    for stem, (panel, _) in (CHOICES["of_people"] | muscles).items():
        name = f"{side}_{stem}"
        choose(signals, name, over=1)
        walks, people = (drawn(signals, each, name) for each in ("signal", "people"))
        if panel in MUSCLES:
            x = drawn(signals, "on", name)["x"].reshape(-1, 4)
            assert x[:, [0, 3]].tolist() == PANELS[panel].on_percent, name
            continue
        scale = np.ptp(people["y"])
        difference = np.abs(walks["y"] - people["y"])
        assert np.median(difference) < 0.01 * scale, name
        assert ((people["low"] <= people["y"]) & (people["y"] <= people["high"])).all()


def test_powers_are_work_over_time(reference):
    """What they sum to is the work of the torques over the angles."""
    trajectory, _ = recorded(reference, 0)
    columns = own_columns(trajectory)
    torque, angle = (
        columns[f"l_ankle_plantarflexion_{unit}"] for unit in ("torque_nm", "rad")
    )
    work_j = np.sum(torque[1:] * np.diff(angle))
    power_w = columns["l_ankle_plantarflexion_power_w"]
    assert np.sum(power_w) / 200.0 == pytest.approx(work_j, rel=1e-6)
    # An ankle that pushes off gives more than it takes, at least once a stride.
    assert power_w.max() > 100.0

"""Where a gait walks: every choice of the page is a configuration that the commands take."""

from pathlib import Path

import numpy as np
import pytest

from study.experiment.experiment import as_written, read_experiment
from study.explore.walk import DISTURBANCES, GROUNDS, WORLDS, Setting, chosen_setting, to_toml
from study.options import config_path
from taichi_nmm.config import read_toml
from taichi_nmm.errors import InputError


def same_robot(one: Setting, other: Setting) -> None:
    """Body, world and ground have the same bits."""
    bodies = [each.experiment.body(each.run) for each in (one, other)]
    np.testing.assert_array_equal(bodies[0].mass_kg, bodies[1].mass_kg)
    worlds = [each.experiment.world(each.run) for each in (one, other)]
    np.testing.assert_array_equal(worlds[0].strength, worlds[1].strength)
    heights = [each.experiment.terrain(each.run).height_m for each in (one, other)]
    np.testing.assert_array_equal(*heights)
    conditions = one.experiment.conditions, other.experiment.conditions
    assert conditions[0].simulation_document() == conditions[1].simulation_document()


def reread(setting: Setting, folder: Path) -> Setting:
    path = folder / "walk.toml"
    path.write_text(setting.toml())
    return Setting(read_experiment(path), setting.run)


@pytest.mark.parametrize("ground", GROUNDS)
def test_a_chosen_setting_is_a_configuration(ground: str, tmp_path: Path) -> None:
    for seed, (world, disturbance) in enumerate(zip(WORLDS, [*DISTURBANCES] * 2, strict=False)):
        engine = ("taichi", "mujoco")[seed % 2]
        setting = chosen_setting(ground, disturbance, seed, world, engine, 12.5)
        assert setting.experiment.conditions.settings.engine == engine
        same_robot(setting, reread(setting, tmp_path))


@pytest.mark.parametrize(
    "name", ["rough8-smooth", "mujoco-rough8-soft", "outside-weak", "ramp-up-torso"]
)
def test_a_run_of_an_experiment_is_a_configuration(name: str, tmp_path: Path) -> None:
    experiment = read_experiment(config_path(name))
    setting = Setting(experiment, run=7)
    again = reread(setting, tmp_path)
    same_robot(setting, again)
    assert as_written(again.experiment) == as_written(experiment)


def test_a_seed_that_no_configuration_takes() -> None:
    with pytest.raises(InputError, match="seed: -1"):
        chosen_setting("flat", "nominal", -1, "nominal", "taichi", 5.0)


def test_tables_within_tables_come_last(tmp_path: Path) -> None:
    tables = {"a": {"b": {"c": 1.5}, "d": [1, 2]}, "e": "x\ty", "f": True}
    (tmp_path / "t.toml").write_text(to_toml(tables))
    assert read_toml(tmp_path / "t.toml").unread == tables

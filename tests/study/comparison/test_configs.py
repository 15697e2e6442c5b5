"""The configurations of experiments that come with the repository."""

import tomllib
from pathlib import Path

import pytest

from study.comparison.arms import find_arm
from study.comparison.experiment import read_experiment
from study.comparison.stores import store_path

CONFIGS = Path(__file__).parents[3] / "configs"
EXPERIMENTS = [file for file in sorted(CONFIGS.glob("*.toml")) if "\narms = " in file.read_text()]


@pytest.mark.parametrize("file", EXPERIMENTS, ids=lambda file: file.stem)
def test_an_experiment_can_be_read_and_its_arms_have_their_stores(file: Path) -> None:
    experiment = read_experiment(file)
    assert experiment.name == file.stem
    assert (experiment.runs, experiment.trials) == (50, 100)
    for name in experiment.arms:
        arm = find_arm(name)
        assert not arm.store or store_path(experiment, arm.store)
    first, last = experiment.terrain(0), experiment.terrain(49)
    drawn = tomllib.loads(file.read_text())["terrain"]["kind"] in ("rough", "blocks")
    assert (first.height_m.tobytes() != last.height_m.tobytes()) == drawn
    assert (experiment.body(0).mass_kg != experiment.body(49).mass_kg).all()


def test_no_two_experiments_share_a_seed() -> None:
    seeds = [read_experiment(file).seed for file in EXPERIMENTS]
    assert len(set(seeds)) == len(seeds) > 0

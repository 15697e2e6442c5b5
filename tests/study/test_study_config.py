"""Configurations of studies: what they draw, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from study.config import read_study_config
from taichi_nmm.errors import InputError

ROUGH8 = Path(__file__).parents[2] / "configs" / "rough8.toml"


def edited(tmp_path: Path, old: str, new: str) -> Path:
    """rough8 with one line changed."""
    text = ROUGH8.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "study.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


def test_rough8_is_the_papers_rough_ground() -> None:
    config = read_study_config(ROUGH8)
    assert config.name == "rough8"
    assert config.duration_s == 100.0
    assert config.score == "phi_printed"
    assert len(config.bodies) == 1
    assert 0 < np.abs(config.bodies.mass_kg.sum() / 80.0 - 1.0) < 0.15
    assert 0.005 < np.abs(np.diff(config.terrain.height_m)).max() * 20 <= 0.08


def test_the_seed_draws_body_and_ground(tmp_path: Path) -> None:
    one = read_study_config(ROUGH8).identity()
    assert read_study_config(ROUGH8).identity() == one
    two = read_study_config(edited(tmp_path, "seed = 1", "seed = 2")).identity()
    assert {key for key in one if one[key] != two[key]} == {"seed", "body", "terrain"}


def test_arch_is_taken_from_the_command_and_changes_no_study() -> None:
    config = read_study_config(ROUGH8, arch="cpu")
    assert config.settings.arch == "cpu"
    assert config.identity() == read_study_config(ROUGH8).identity()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed = 1", "seed = -1", "seed: -1"),
        ("seed = 1", "seed = 1\ntrials = 30", "trials: 30 .* only the keys name, seed, objective"),
        ("seed = 1", "", "seed: 'missing'"),
        ('"rough8"', '"rough 8/x"', "name: 'rough 8/x'"),
        ('cost = "smooth"', 'cost = "cheap"', "objective.cost: 'cheap' .* smooth or walking"),
        ("duration_s = 100.0", "duration_s = 0", "simulation.duration_s: 0"),
        ("duration_s = 100.0", "duration = 100.0", "simulation.duration: 100.0"),
        ("disturbance = 0.15", "disturbance = 1.5", "body.disturbance: 1.5"),
        ("amplitude_m = 0.08", "amplitude = 8", "terrain.amplitude: 8"),
        ('store = "out/store"', "", "dog.store: 'missing'"),
        ("startup_trials = 3", "startup_trials = 0", "dog.startup_trials: 0"),
        ("startup_trials = 3", "n_startup = 3", "dog.n_startup: 3"),
    ],
)
def test_bad_configurations_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_study_config(edited(tmp_path, old, new))


def test_a_missing_file_is_refused() -> None:
    with pytest.raises(InputError, match=r"config: 'no\.toml'"):
        read_study_config("no.toml")

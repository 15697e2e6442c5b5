"""Configurations of experiments: what they draw, what is refused, and those that come with us."""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest

from storage.inputs.config import read_toml, read_whole
from storage.inputs.errors import InputError
from storage.specification import read_specification
from study.bench.plan import read_plan
from study.experiment.arms import find_arm
from study.experiment.experiment import store_path
from study.experiment.robots import is_of_robots
from study.experiment.walker import as_written, read_experiment
from study.options import config_path, shipped_configs
from taichi_nmm.parameters import GAIN_NAMES
from tests.cases import cases, refused

CONFIGS = Path(__file__).parents[3] / "configs"
ROUGH8 = CONFIGS / "rough8.toml"
EXPERIMENTS = [
    file
    for name in shipped_configs(stores=False)
    if name != "flat" and not is_of_robots(file := config_path(name))
]
PUBLISHED = [
    f for f in EXPERIMENTS if f != ROUGH8 and not f.stem.startswith("optimum-")
]


def edited(tmp_path, old, new):
    """rough8 with one line changed."""
    text = ROUGH8.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "study.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


def test_rough8_is_the_papers_rough_ground():
    experiment = read_experiment(ROUGH8, arch="cpu")
    assert (experiment.name, experiment.objective.cost) == ("rough8", "smooth")
    assert experiment.conditions.duration_s == 100.0 and experiment.names == GAIN_NAMES
    assert experiment.conditions.settings.arch == "cpu"  # of the command
    body, ground = experiment.body(0), experiment.terrain(0)
    assert len(body) == 1 and 0 < np.abs(body.mass_kg.sum() / 80.0 - 1.0) < 0.15
    assert 0.005 < np.abs(np.diff(ground.height_m)).max() * 20 <= 0.08


def test_the_seed_and_the_run_draw_body_and_ground(tmp_path):
    one, again = read_experiment(ROUGH8), read_experiment(ROUGH8)
    two = read_experiment(edited(tmp_path, "seed = 1", "seed = 2"))
    assert read_experiment(ROUGH8, seed=2) == two

    def drawn(experiment, run):
        return experiment.body(run).mass_kg.tobytes(), experiment.terrain(
            run
        ).height_m.tobytes()

    assert drawn(one, 3) == drawn(again, 3)
    different = [drawn(one, 3), drawn(one, 4), drawn(two, 3)]
    assert all(len(set(parts)) == 3 for parts in zip(*different, strict=True))


def test_an_experiment_pickles_and_hashes_and_writes_what_decides_trials():
    experiment = read_experiment(ROUGH8)
    copy = pickle.loads(pickle.dumps(experiment))
    assert copy == experiment and hash(copy) == hash(experiment)
    names = {"name", "seed", "searched", "objective", "simulation", "body", "terrain"}
    written = as_written(experiment)
    assert set(written) == names
    one_thread = experiment.on_one_thread()  # for one of several processes
    assert (
        one_thread.conditions.settings.threads == 1
        and as_written(one_thread) == written
    )


@cases("bad-experiments.toml", "old", "new", "message")
def test_bad_configurations_are_refused(tmp_path, old, new, message):
    with refused(message):
        read_experiment(edited(tmp_path, old, new))


@cases("several-mistakes.toml", "text", "fields")
def test_all_mistakes_of_a_file_are_named_at_once(tmp_path, text, fields):
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        if "goal" in text:
            read_plan(path)
        elif "samples" in text:
            read_whole(read_toml(path), read_specification)
        else:
            read_experiment(path)
    found = pickle.loads(pickle.dumps(caught.value))  # it may come from another process
    lines = str(found).splitlines()
    assert [line.partition(": ")[0] for line in lines] == fields.split()
    assert all("cannot be used; allowed: " in line for line in lines)


@pytest.mark.parametrize("file", EXPERIMENTS, ids=lambda file: file.stem)
def test_an_experiment_can_be_read_and_its_arms_have_their_stores(file):
    experiment = read_experiment(file)
    assert experiment.name == file.stem
    for name in experiment.arms:
        arm = find_arm(name)
        assert not arm.store or store_path(experiment, arm.store)
    conditions = experiment.conditions
    first, last = experiment.terrain(0), experiment.terrain(49)
    drawn = conditions.ground.kind in ("rough", "blocks")
    assert (first.height_m.tobytes() != last.height_m.tobytes()) == drawn
    other = experiment.body(0).mass_kg != experiment.body(49).mass_kg
    assert other.all() if conditions.build.disturbance else not other.any()


@pytest.mark.parametrize("file", PUBLISHED, ids=lambda file: file.stem)
def test_a_published_comparison_is_50_runs_of_40_trials_of_disturbed_bodies(file):
    """More where the paper has more, and up stairs; or of what comes before the first walker."""
    experiment = read_experiment(file)
    elsewhere = (
        file.stem.startswith(("mujoco-", "outside-")) and "limp" not in file.stem
    )
    hardly_any = file.stem == "stairs-up-high"
    assert experiment.until_walker == (elsewhere or hardly_any)
    trials = {"rough8-smooth": 100, "rough6-walking": 60}.get(file.stem, 40)
    trials = 100 if file.stem.startswith("stairs-up") else trials
    own = {"speed": (20, 50), "exo": (20, 30), "prosthesis": (20, 30), "even": (20, 50)}
    shape = own.get(file.stem.removeprefix("outside-").partition("-")[0], (50, trials))
    assert (experiment.runs, experiment.trials) == shape
    assert experiment.conditions.build.disturbance > 0


def test_no_two_experiments_share_a_seed():
    """But those of the same robots: on another engine's contacts, at other speeds, by side."""
    contacts = re.compile(
        r"^(mujoco-.+|speed|outside-even-limp)-(soft|middle|hard|\d\d.*|sides)$"
    )
    seeds = {
        contacts.sub(r"\1", file.stem): read_experiment(file).seed
        for file in EXPERIMENTS
    }
    assert len(set(seeds.values())) == len(seeds) > 0
    for file in EXPERIMENTS:
        assert read_experiment(file).seed == seeds[contacts.sub(r"\1", file.stem)]

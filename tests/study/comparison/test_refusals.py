"""What a comparison refuses, in one line, before anything is computed."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from study.comparison.experiment_folder import ExperimentFolder
from study.experiment import arms
from study.experiment.experiment import read_experiment
from taichi_nmm.errors import InputError
from tests.study import fake_walker
from tests.study.conftest import Comparisons


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"arms": ("dog", "cat")}, "arm: 'cat' .* one of random, "),
        ({"arms": ()}, None),
        ({"runs": 0}, "runs: 0"),
        ({"trials": 0}, "trials: 0"),
        ({"trials": 151}, "trials: 151 .* at most 150"),
        ({"workers": 0}, "workers: 0"),
        ({"arms": ("best-of-nothing",)}, "arm: 'best-of-nothing'"),
    ],
)
def test_requests(request_: dict[str, Any], message: str | None, comparisons: Comparisons) -> None:
    if message is None:  # no arms asked for: the configuration's
        assert comparisons.run("out", **request_).computed == 72
        return
    fake_walker.calls.clear()
    with pytest.raises(InputError, match=message):
        comparisons.run("out", **request_)
    assert not fake_walker.calls
    assert not (comparisons.folder / "out").exists()


def test_an_arm_without_its_library(
    comparisons: Comparisons, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arms.importlib.util, "find_spec", lambda name: None)  # type: ignore[attr-defined]
    with pytest.raises(InputError, match=r"gp-optuna.*pip install torch"):
        comparisons.run("out", arms=("gp-optuna",))


def edited(comparisons: Comparisons, old: str, new: str) -> Path:
    path = comparisons.folder / "edited.toml"
    text = fake_walker.write_config(comparisons.folder).read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed = 5", "seed = 6", "seed: 6 .* 5, as"),
        ('cost = "smooth"', 'cost = "walking"', "objective.cost: 'walking'"),
        ('kind = "rough"', 'kind = "flat"', "terrain.name: 'flat'"),
        ("disturbance = 0.15", "disturbance = 0.1", "body.disturbance"),
        ("duration_s = 20.0", "duration_s = 30.0", "simulation.duration_s"),
        ('name = "toy"', 'name = "boy"', "name: 'boy'"),
    ],
)
def test_another_experiment_in_the_folder(
    old: str, new: str, message: str, comparisons: Comparisons
) -> None:
    comparisons.run("out", arms=("random",), trials=1)
    before = comparisons.content("out")
    with pytest.raises(InputError, match=message):
        comparisons.run("out", experiment=read_experiment(edited(comparisons, old, new)))
    assert comparisons.content("out") == before


def test_a_folder_of_version_0_1_0(comparisons: Comparisons) -> None:
    """Its document says the version, and not yet the ground."""
    comparisons.run("out", arms=("random",), trials=1)
    before = comparisons.content("out")
    file = comparisons.folder / "out" / "experiment.json"
    document = json.loads(file.read_text())
    del document["ground"]
    document["versions"]["taichi-nmm"] = "0.1.0"
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"versions\.taichi-nmm: .* '0\.1\.0'") as caught:
        comparisons.run("out", arms=("random",), trials=2)
    assert "\n" not in str(caught.value)
    assert comparisons.content("out") == before


def test_another_store_in_the_folder(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("dog",), trials=1)
    fake_walker.write_store(comparisons.folder / "other", seed=4)
    config = edited(
        comparisons, f'flat = "{comparisons.folder}/store"', f'flat = "{comparisons.folder}/other"'
    )
    with pytest.raises(InputError, match=r"stores.flat: .* as .*experiment\.json"):
        comparisons.run("out", experiment=read_experiment(config), arms=("dog",), trials=2)
    # An arm that does not read it may still be added.
    comparisons.run("out", experiment=read_experiment(config), arms=("random",), trials=2)


def test_another_definition_of_an_arm_in_the_folder(
    comparisons: Comparisons, monkeypatch: pytest.MonkeyPatch
) -> None:
    comparisons.run("out", arms=("dog",), trials=1)
    changed = replace(arms.ARMS["dog"], options={"kernel": "additive"})
    monkeypatch.setitem(arms.ARMS, "dog", changed)
    with pytest.raises(InputError, match=r"arms\.dog\.options.*another --out"):
        comparisons.run("out", arms=("dog",), trials=2)


@pytest.mark.parametrize(
    ("new", "message"),
    [
        ('flat = "nowhere"', "nowhere"),
        ('plane = "nowhere"', "stores.flat: 'missing' .* which has plane, robust, mild"),
    ],
)
def test_a_store_that_is_not_there(new: str, message: str, comparisons: Comparisons) -> None:
    config = edited(comparisons, f'flat = "{comparisons.folder}/store"', new)
    with pytest.raises(InputError, match=message):
        comparisons.run("out", experiment=read_experiment(config))
    assert not (comparisons.folder / "out").exists()


def test_a_store_without_a_feature(comparisons: Comparisons) -> None:
    fake_walker.write_store(comparisons.folder / "plain", robust={}, families={})
    line = f'robust = "{comparisons.folder}/'
    config = edited(comparisons, f'{line}store"', f'{line}plain"')
    with pytest.raises(InputError, match=r"plain.*robust_survived_fraction_mean"):
        comparisons.run("out", experiment=read_experiment(config))


def test_a_store_of_other_parameters(comparisons: Comparisons) -> None:
    config = edited(comparisons, "seed = 5", 'seed = 5\nsearched = ["theta_ref"]')
    with pytest.raises(InputError, match=r"stores.flat: .*without theta_ref"):
        comparisons.run("out", experiment=read_experiment(config))


def test_two_processes_on_one_folder(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("random",), trials=1)
    document = json.loads((comparisons.folder / "out" / "experiment.json").read_text())
    with (
        ExperimentFolder.claim(comparisons.folder / "out", document),
        pytest.raises(InputError, match="no other process"),
    ):
        comparisons.run("out")


def test_a_folder_of_something_else(comparisons: Comparisons) -> None:
    (comparisons.folder / "out").mkdir()
    (comparisons.folder / "out" / "thesis.tex").touch()
    with pytest.raises(InputError, match=r"thesis\.tex"):
        comparisons.run("out")


def test_a_damaged_arm(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("random",))
    file = comparisons.folder / "out" / "arms" / "random.parquet"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"random\.parquet"):
        comparisons.run("out", arms=("random",))


def test_trials_that_the_sampler_did_not_propose(comparisons: Comparisons) -> None:
    comparisons.run("out", arms=("cmaes-cold",), trials=4)
    (comparisons.folder / "out" / "arms" / "cmaes-cold.parquet").unlink()
    comparisons.run("other", arms=("random",), trials=4)
    with ExperimentFolder.claim(comparisons.folder / "other", _document(comparisons)) as folder:
        table = folder.read_arm("random")
        column = table.schema.get_field_index("arm")
        renamed = table.set_column(column, table.schema.field("arm"), [["cmaes-cold"] * len(table)])
        folder.write_arm("cmaes-cold", renamed)
    with pytest.raises(InputError, match=r"cmaes-cold, run 0, trial 0.*another --out"):
        comparisons.run("other", arms=("cmaes-cold",), trials=5)


def _document(comparisons: Comparisons) -> dict[str, Any]:
    text = (comparisons.folder / "other" / "experiment.json").read_text()
    document: dict[str, Any] = json.loads(text)
    return document

"""What is refused of an experiment and its arms before any work: always one line."""

from dataclasses import replace
from pathlib import Path

import pytest

from study.experiment import arms
from study.experiment.arms import PRINTED, find_arm
from study.experiment.check import check_arms, with_store
from study.experiment.experiment import Experiment
from study.experiment.off_grid import StoreFeatures
from study.experiment.stores import candidates, store_path
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import K_T
from tests.study import fake_walker

ROWS = fake_walker.STORE_ROWS


def test_arms_are_found_each_once_in_their_order(toy: Experiment) -> None:
    found = check_arms(toy, ("dog", "random", "dog"), ROWS)
    assert found == (find_arm("dog"), find_arm("random"))


def test_every_arm_that_is_installed_can_run_on_the_toys_store(toy: Experiment) -> None:
    runnable = [arm.name for arm in arms.ARMS.values() if not arm.needs]
    assert len(check_arms(toy, runnable, 20)) == len(runnable)


@pytest.mark.parametrize(
    ("names", "trials", "message"),
    [
        ((), 8, "arms: 'none' .* one arm or more"),
        (("dog", "cat"), 8, "arm: 'cat' .* one of random, "),
        (("dog",), ROWS + 1, rf"trials: {ROWS + 1} .* at most {ROWS}, the rows that dog may take"),
        (("score-first",), ROWS + 1, f"at most {ROWS}, the rows that score-first"),
        (("dog-off-grid",), ROWS + 1, f"at most {ROWS}"),
    ],
)
def test_arms_that_cannot_run(
    names: tuple[str, ...], trials: int, message: str, toy: Experiment
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        check_arms(toy, names, trials)
    assert "\n" not in str(caught.value)


def test_an_arm_without_a_store_may_run_any_number_of_trials(toy: Experiment) -> None:
    assert check_arms(replace(toy, stores={}), ("random", "cmaes-cold"), 100_000)


def test_rows_that_an_arm_leaves_out_do_not_count(toy: Experiment, tmp_path: Path) -> None:
    strict = {"settings": 1, "min_survival_s": 2.8, "body": {"disturbance": 0.15}}
    families = dict.fromkeys(("rough", "blocks", "up", "down"), strict)
    fake_walker.write_store(tmp_path / "strict", families=families)
    experiment = replace(toy, stores={"diverse": tmp_path / "strict"})
    rows = int(candidates(experiment, "diverse", find_arm("best").features).rows.offered.sum())
    assert 0 < rows < ROWS
    assert check_arms(experiment, ("best",), rows)
    with pytest.raises(InputError, match=rf"trials: {rows + 1} .* at most {rows}, the rows that b"):
        check_arms(experiment, ("best",), rows + 1)


def test_an_arm_without_its_library(toy: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arms.importlib.util, "find_spec", lambda name: None)  # type: ignore[attr-defined]
    with pytest.raises(InputError, match=r"gp-optuna.*pip install torch"):
        check_arms(toy, ("gp-optuna",), 3)


def test_a_store_that_the_configuration_does_not_name(toy: Experiment) -> None:
    stores = {name: path for name, path in toy.stores.items() if name != "flat"}
    experiment = replace(toy, stores=stores)
    with pytest.raises(InputError, match=r"stores\.flat: 'missing' .* which has robust, mild"):
        check_arms(experiment, ("dog",), 3)
    with pytest.raises(InputError, match=r"stores\.flat: 'missing' .* which has none"):
        store_path(replace(toy, stores={}), "flat")
    assert check_arms(experiment, ("score-first",), 3)


def test_a_store_that_is_not_there(toy: Experiment, tmp_path: Path) -> None:
    stores = dict(toy.stores) | {"flat": tmp_path / "nowhere"}
    with pytest.raises(InputError, match="nowhere"):
        check_arms(replace(toy, stores=stores), ("dog",), 3)


def test_a_store_without_a_feature(toy: Experiment, tmp_path: Path) -> None:
    fake_walker.write_plain_store(tmp_path / "plain")
    experiment = replace(toy, stores=dict.fromkeys(toy.stores, tmp_path / "plain"))
    assert check_arms(experiment, ("dog", "cmaes-warm"), 3)
    with pytest.raises(InputError, match=r"plain.*robust_survived_fraction_mean"):
        check_arms(experiment, ("score-first",), 3)
    with pytest.raises(InputError, match=r"plain.*rough_survived_fraction_mean"):
        check_arms(experiment, ("best",), 3)


def test_a_store_of_other_parameters(toy: Experiment, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"stores.flat: .*store without theta_ref"):
        check_arms(replace(toy, searched=("theta_ref",)), ("dog",), 3)
    fake_walker.write_store(tmp_path / "torso", searched=["theta_ref"])
    experiment = replace(toy, stores={"flat": tmp_path / "torso"})
    with pytest.raises(InputError, match=r"stores.flat: .*torso with theta_ref"):
        check_arms(experiment, ("dog",), 3)
    assert check_arms(replace(experiment, searched=("theta_ref",)), ("dog",), 3)


@pytest.mark.parametrize(
    ("change", "features", "message"),
    [
        ({"terrain": {"kind": "rough"}}, ("phi_printed",), "whose base setting is level ground"),
        ({"body": {"disturbance": 0.1}}, ("phi_printed",), "and the undisturbed body"),
        ({}, ("phi",), "feature: 'phi' .* one of"),
    ],
)
def test_points_off_the_grid_of_such_a_store_cannot_be_scored(
    change: dict[str, object],
    features: tuple[str, ...],
    message: str,
    toy: Experiment,
    tmp_path: Path,
) -> None:
    fake_walker.write_store(tmp_path / "other", **change)
    experiment = replace(toy, stores={"flat": tmp_path / "other"})
    with pytest.raises(InputError, match=message):
        StoreFeatures(experiment, "flat", features)


def test_points_off_the_grid_are_simulated_as_their_store_was(
    toy: Experiment, tmp_path: Path
) -> None:
    simulation = {"engine": "mujoco", "mujoco": {"time_constant_s": 0.01}}
    fake_walker.write_store(tmp_path / "mujoco", simulation=simulation)
    features = StoreFeatures(replace(toy, stores={"flat": tmp_path / "mujoco"}), "flat", PRINTED)
    fake_walker.calls.clear()
    assert features(K_T[None]).shape == (1, 1)
    settings = fake_walker.calls[-1]["settings"]
    assert (settings.engine, settings.mujoco.time_constant_s) == ("mujoco", 0.01)


def test_a_store_of_the_callers_is_that_of_the_arms(toy: Experiment, tmp_path: Path) -> None:
    experiment = with_store(toy, ("random", "dog", "cmaes-source"), tmp_path)
    assert experiment.stores == {**toy.stores, "flat": tmp_path} != toy.stores
    assert replace(experiment, stores=toy.stores) == toy


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("random", "tpe"), "store: '.*' .* arms that read one store; random, tpe: none"),
        (("dog", "best"), "store: '.*' .* arms that read one store; dog, best: diverse and flat"),
        (("dog", "cat"), "arm: 'cat' "),
    ],
)
def test_a_store_for_arms_that_read_none_or_several(
    names: tuple[str, ...], message: str, toy: Experiment, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        with_store(toy, names, tmp_path)

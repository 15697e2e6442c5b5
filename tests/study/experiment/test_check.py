"""What is refused of an experiment and its arms before any work: always one line."""

from dataclasses import replace

from study.experiment.arms import check_arms, find_arm, with_store
from study.experiment.experiment import candidates, store_path
from tests.cases import refused
from tests.study import fake_walker

ROWS = fake_walker.STORE_ROWS


def test_arms_are_found_each_once_in_their_order(toy):
    assert len(check_arms(toy, fake_walker.ABLE, 20)) == len(fake_walker.ABLE)
    assert check_arms(replace(toy, stores={}), ("random", "cmaes-cold"), 100_000)
    found = check_arms(toy, ("dog", "random", "dog"), ROWS)
    assert found == (find_arm("dog"), find_arm("random"))
    with refused("arms: 'none' .* one arm or more"):
        check_arms(toy, (), 8)


def test_a_store_that_is_not_there_or_not_named(toy, tmp_path):
    experiment = replace(
        toy, stores={n: path for n, path in toy.stores.items() if n != "flat"}
    )
    with refused(r"stores\.flat: 'missing' .* which has worlds, stairs"):
        check_arms(experiment, ("dog",), 3)
    with refused(r"stores\.flat: 'missing' .* which has none"):
        store_path(replace(toy, stores={}), "flat")
    assert check_arms(experiment, ("ranking",), 3)
    with refused("nowhere"):
        check_arms(
            replace(toy, stores=toy.stores | {"flat": tmp_path / "nowhere"}),
            ("dog",),
            3,
        )


def test_a_store_without_a_feature(toy, tmp_path):
    fake_walker.write_plain_store(tmp_path / "plain")
    experiment = replace(toy, stores=dict.fromkeys(toy.stores, tmp_path / "plain"))
    assert check_arms(experiment, ("dog", "cmaes-warm"), 3)
    with refused("plain.*a store with the column phi_reprinted"):
        candidates(experiment, "flat", "phi_reprinted")
    for arm in ("ranking", "worlds"):
        with refused("plain.*a store with families of worlds"):
            check_arms(experiment, (arm,), 3)


def test_a_store_is_read_once_and_anew_when_made_anew(toy, tmp_path):
    feature = find_arm("ranking").feature
    before = candidates(toy, "worlds", feature)
    assert candidates(toy, "worlds", feature) is before
    toy.stores["worlds"].rename(tmp_path / "before")
    fake_walker.write_store(toy.stores["worlds"], samples=100)
    assert len(before) != len(candidates(toy, "worlds", feature))


def test_a_store_of_other_parameters(toy, tmp_path):
    with refused(r"stores.flat: .*store without theta_ref"):
        check_arms(replace(toy, searched=("theta_ref",)), ("dog",), 3)
    fake_walker.write_store(tmp_path / "torso", searched=["theta_ref"])
    experiment = replace(toy, stores={"flat": tmp_path / "torso"})
    with refused(r"stores.flat: .*torso with theta_ref"):
        check_arms(experiment, ("dog",), 3)
    assert check_arms(replace(experiment, searched=("theta_ref",)), ("dog",), 3)


def test_a_store_of_the_callers_is_that_of_the_arms(toy, tmp_path):
    experiment = with_store(toy, ("random", "dog", "cmaes-warm"), tmp_path)
    assert experiment.stores == {**toy.stores, "flat": tmp_path} != toy.stores
    assert replace(experiment, stores=toy.stores) == toy
    one = "store: '.*' .* arms that read one store; "
    for names, message in (
        (("random", "tpe"), f"{one}random, tpe: none"),
        (("dog", "cat"), "arm: 'cat' "),
        (("dog", "worlds"), f"{one}dog, worlds: flat and worlds"),
    ):
        with refused(message):
            with_store(toy, names, tmp_path)

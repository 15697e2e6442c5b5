"""The page of a store of somebody else's simulator: a row's numbers, and a film of it."""

import numpy as np
import pytest
from optuna.distributions import IntDistribution

from storage import make_store
from storage.inputs.errors import InputError
from study.explore.page import BASE, numbers_text, page_of, worlds_of
from study.explore.store_view import first_columns, numbers_of, numeric_columns
from tests.browser import opened_page
from tests.storage import plants, rail, robot
from tests.study.explore.serving import change, explorer

GALE = {"settings": 2, "min_survival_s": 3.0, "world": {"wind": [1.0, 3.0]}}
HEAVY = {"settings": 2, "min_survival_s": 0.2, "world": {"mass": [1.0, 2.0]}}


def made(simulator, path, samples, **settings):
    return make_store(simulator, path, workers=1, samples=samples, **settings)


def numbers(drawn, place):
    """Of a world that a store's specification has."""
    return {name: float(each[place]) for name, each in drawn.items()}


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    path = tmp_path_factory.mktemp("stores") / "cart"
    return made(robot.Cart, path, 32, families={"gale": GALE})


def test_worlds_and_columns_are_the_stores_own(cart):
    drawn = cart.specification["families"]["gale"]["drawn"]
    assert worlds_of(cart) == {
        BASE: numbers(cart.specification["drawn"], 0),
        "gale 0": numbers(drawn, 0),
        "gale 1": numbers(drawn, 1),
    }
    columns = first_columns(cart, numeric_columns(cart))
    assert len(set(columns)) == 5 and columns[2] == "gale_survived_fraction_mean"
    text = numbers_text(cart, 3)
    assert f"<td>thrust_n</td><td>{cart.points()[3, 0]:.4g}</td>" in text
    assert "_worlds" not in text


HOT = {"settings": 4, "min_survival_s": 0.0, "world": {"heat_k": [340.0, 370.0]}}
WARM = {"settings": 2, "min_survival_s": 3000.0}


def test_what_a_failed_run_did_not_give_is_unknown(tmp_path):
    """A battery that burns has lost no 0 J: not on the page, and not in a family's mean."""
    store = made(
        plants.Battery,
        tmp_path / "b",
        samples=16,
        simulation={"duration_s": 3000.0},
        families={"hot": HOT, "warm": WARM},
        world={"heat_k": 365.0},
    )
    rows, losses = store.numpy(), store.outcomes("hot", "loss_j")
    failed, unknown = rows["run_ended"] == "failed", np.isnan(losses)
    assert 0 < failed.sum() < 16
    assert unknown.any() and not unknown.all(axis=1).any()
    assert np.array_equal(np.isnan(numbers_of(store, "loss_j")), failed)
    survived = numbers_of(store, "survived_fraction")
    assert np.array_equal(survived, rows["survived_fraction"])
    mean, sd = np.nanmean(losses, axis=1), np.nanstd(losses, axis=1)
    assert rows["hot_loss_j_mean"] == pytest.approx(mean, rel=1e-12)
    assert rows["hot_loss_j_sd"] == pytest.approx(sd, rel=1e-9, abs=1e-9)
    ran = rows["warm_evaluated"]
    assert 0 < ran.sum() < 16
    assert np.isnan(numbers_of(store, "warm_loss_j_mean"))[~ran].all()
    text = numbers_text(store, int(np.flatnonzero(failed)[0]))
    for name in ("loss_j", "warm_loss_j_mean"):
        assert f"<td>{name}</td><td>-</td>" in text


def test_rows_that_mean_something_else_to_a_simulator_are_not_filmed(
    tmp_path,
):
    wide = rail.made(parameters=rail.PARAMETERS | {"beats": IntDistribution(1, 9)})
    store = made(wide, tmp_path / "rail", 4, simulation={"duration_s": 0.1})
    with pytest.raises(InputError, match=r"^store\.gains\.beats: .*'high': 4\.0"):
        page_of(store.path, tmp_path, simulator="tests/storage/rail.py:Rail")


def test_the_table_robust_is_a_family_like_others(tmp_path):
    store = made(robot.Cart, tmp_path / "cart", 8, robust=GALE, world={"wind": 2.0})
    worlds, drawn = worlds_of(store), store.specification["robust"]["drawn"]
    assert worlds["robust 1"] == numbers(drawn, 1)
    assert worlds[BASE]["wind"] == 2.0  # which is not the simulator's own


def test_a_simulator_that_has_nothing_to_film_is_refused(cart):
    for name, allowed in (
        ("robot.py:Cart", "a MujocoSimulator"),
        ("rail.py:Rail", "thrust_n"),
    ):
        with pytest.raises(InputError, match=f"^simulator: .*{allowed}"):
            page_of(cart.path, cart.path, simulator=f"tests/storage/{name}")


@pytest.mark.slow
def test_a_click_shows_numbers_and_films_the_row(tmp_path):
    store = made(
        rail.Rail,
        tmp_path / "rail",
        samples=8,
        simulation={"duration_s": 0.5},
        families={"heavy": HEAVY},
    )
    asked = ("--simulator", "tests/storage/rail.py:Rail")
    with explorer(store.path, *asked) as address, opened_page(1500, 900) as page:
        page.goto(address)
        page.wait_for_function("window.Bokeh?.documents[0] && named('numbers')")
        change(page, "row", "value", 5)
        page.wait_for_function("named('numbers').text.includes('kp')")
        page.wait_for_function(
            "named('film').text.includes('video/mp4') || named('message').text.includes('OpenGL')"
        )
        worlds = page.evaluate("named('world').options")
        assert worlds == [BASE, "heavy 0", "heavy 1"]

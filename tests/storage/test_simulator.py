"""The seam: any simulator has a store, here a cart of three parameters in one file."""

import re
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest

from storage import merge, open_store
from storage.inputs.config import Table
from storage.points import sobol_points
from storage.pool import own_kind
from storage.precompute import precompute
from storage.simulator import (
    SIMULATORS,
    Uniform,
    find_simulator,
    judge_rows,
    known_simulator,
)
from storage.specification import GENERATION, STARTS, read_specification
from tests.cases import asset, refused
from tests.processes import printed, python
from tests.storage import toy

TOY = "tests.storage.toy"
CART = f"{TOY}:Cart"
CONFIGURATION = asset("toy-store.toml")
REPERTOIRE = {"evaluations": STARTS + 2 * GENERATION, "settings": 1, "candidates": 20}


def specification(**changes):
    return read_specification(Table(CONFIGURATION | changes))


def test_a_store_of_another_simulator_is_filled_and_read(tmp_path):
    summary = precompute(specification(), tmp_path / "store")
    store = open_store(tmp_path / "store", verify=True)
    rows = store.numpy()
    assert store.parameter_names == ("thrust", "drag", "steer") == tuple(store.bounds)
    with pytest.raises(AttributeError, match=r"gains is called Store\.points\(\) now"):
        store.gains()
    assert store.families == ("gale", "storm")
    points = sobol_points(4, 0, 60, toy.Cart.parameters)
    assert np.array_equal(store.points(), points)
    assert np.array_equal(
        rows["speed"], (points[:, 0] / points[:, 1] / 2.0).astype(np.float32)
    )
    assert set(rows["end_reason"]) == {"arrived", "blown off"}
    assert summary.alive_at_horizon == np.count_nonzero(rows["end_reason"] == "arrived")
    gale, storm = rows["gale_evaluated"], rows["storm_evaluated"]
    assert np.array_equal(gale, rows["way"] >= 0.8)
    assert np.array_equal(storm, gale & (rows["gale_way_mean"] >= 0.5))
    assert 0 < storm.sum() < gale.sum() < 60
    winds = specification().families[0].worlds
    survived = np.exp(np.minimum(0.5 - winds * np.abs(points[gale, 2:]), 0.0))
    np.testing.assert_allclose(rows["gale_way_mean"][gale], survived.mean(axis=1))
    np.testing.assert_allclose(rows["gale_way_sd"][gale], survived.std(axis=1))
    assert {footer["engine"] for footer in store.footers} == {"cart"}
    merged = merge(tmp_path / "store", tmp_path / "merged.parquet")
    assert merged.table().equals(store.table().combine_chunks())
    # A store may come from anybody: no code is imported that a file names.
    store.require_bounds()  # nothing to compare them with
    with refused(r"store\.simulator: 'tests.storage.toy:Cart' .* walker"):
        known_simulator({"simulator": CART})


def test_the_document_names_the_simulator_and_its_worlds():
    document = specification().document
    assert (document["simulator"], document["code_version"]) == (CART, "1")
    assert document["simulation"] == {"duration_s": 5.0}
    assert document["settings"] == {"mass_kg": 2.0}
    assert document["wind"] == [0.5, 1.5] and document["families"]["storm"]["wind"] == [
        3.0,
        4.0,
    ]
    assert list(document["gains"]) == ["thrust", "drag", "steer"]
    assert (
        specification(simulator={"name": CART, "mass_kg": 3.0}).hash
        != specification().hash
    )


@pytest.mark.slow
def test_a_repertoire_of_another_simulator(tmp_path):
    pytest.importorskip("ribs")
    families = {"gale": CONFIGURATION["families"]["gale"]}
    asked = specification(
        samples=300, shard_rows=300, families=families, repertoire=REPERTOIRE
    )
    precompute(asked, tmp_path / "whole")
    store = open_store(tmp_path / "whole")
    assert (
        store.numpy(["origin"])["origin"].tolist() == ["sobol"] * 300 + ["evolved"] * 20
    )
    tried = pq.read_table(tmp_path / "whole" / "repertoire.parquet").to_pydict()
    generation, speed = np.array(tried["generation"]), np.array(tried["tried_speed"])
    assert speed[generation == 2].max() > speed[generation == 0].max() > 0.0
    objective = np.array(tried["objective"])
    assert objective[np.array(tried["row"]) >= 0].min() > np.median(objective)


@pytest.mark.parametrize(("field", "changes"), asset("toy-refusals.toml").items())
def test_a_simulators_own_tables_are_checked(field, changes):
    with refused(rf"^{field}: "):
        specification(**changes)


@pytest.mark.parametrize(
    "name", ["", "cart", TOY, f"{TOY}:Bicycle", "no.module:Cart", ":Cart"]
)
def test_a_simulator_that_is_not_there_is_refused(name):
    with refused(r"^simulator\.name: .*module:Class"):
        specification(simulator={"name": name})


FAULTS = {
    "no column of how far": (
        {"survived": "far"},
        "columns with far, how far a run came",
    ),
    "how far is no score": ({"scores": ("speed",)}, "way among the scores"),
    "a score that is no column": (
        {"scores": ("way", "far")},
        "scores that are columns; 'far'",
    ),
    "a score of words": (
        {"scores": ("way", "end_reason")},
        "numbers; 'end_reason' is none",
    ),
    "words of no column": (
        {"words": {"far": ("a",)}},
        "words that are columns; 'far' is none",
    ),
    "a measure of no column": (
        {"measures": {"far": (0.0, 1.0)}},
        "measures that are columns",
    ),
    "no parameter": ({"parameters": ()}, "one parameter at least"),
    "bounds that are none": (
        {"parameters": (Uniform("a", 1.0, 1.0),)},
        "a has 1.0, 1.0",
    ),
    "no bounds": (
        {"parameters": (Uniform("a", 0.0, np.inf),)},
        "low < high; a has 0.0, inf",
    ),
    "a name twice": (
        {"parameters": (Uniform("way", 0.0, 1.0),)},
        "each once, not 'way'",
    ),
    "the store's name": (
        {"parameters": (Uniform("row", 0.0, 1.0),)},
        "each once, not 'row'",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_simulator_that_makes_no_store(fault, monkeypatch):
    changes, allowed = FAULTS[fault]
    for name, value in changes.items():
        monkeypatch.setattr(toy.Cart, name, value)
    with refused(f"^simulator: '{CART}' .*{re.escape(allowed)}"):
        specification()


def changed(name, value):
    run = toy.Cart.run

    def faulty(self, *args):
        rows, computed_by = run(self, *args)
        rows[name][-1] = value
        return rows, computed_by

    return faulty


ROWS = toy.Cart.columns
FAULTY_RUNS = {  # what is returned, or the method
    "no array": ([1.0], "not <class 'list'>"),
    "other columns": (
        np.zeros((16, 1), [("way", "f8")]),
        "columns way, end_reason, speed of",
    ),
    "other types": (np.zeros((16, 1)), "of their types, not float64"),
    "too few rows": (np.zeros((15, 1), ROWS), "[16 points, 1 worlds], not [15, 1]"),
    "no worlds": (np.zeros(16, ROWS), "1 worlds], not [16]"),
    "a score of NaN": (changed("speed", np.nan), "finite speed, not NaN or infinity"),
    "further than the end": (changed("way", 1.25), "way from 0 to 1, not 1.25"),
    "backwards": (changed("way", -1.0), "way from 0 to 1, not -1"),
    "an unknown word": (changed("end_reason", 2), "end_reason from 0 to 1, not 2"),
}


@pytest.mark.parametrize("fault", FAULTY_RUNS)
def test_a_faulty_run(fault, tmp_path, monkeypatch):
    run, allowed = FAULTY_RUNS[fault]
    monkeypatch.setattr(toy.Cart, "run", run if callable(run) else lambda *_: (run, {}))
    with refused(f"^simulator: '{CART}' .*{re.escape(allowed)}"):
        precompute(specification(), tmp_path / "store")
    assert not list((tmp_path / "store").glob("part-*"))


@pytest.mark.parametrize(
    ("objective", "measures"),
    [
        (np.zeros(4), np.zeros((4, 2))),
        (np.zeros(3), np.zeros((4, 1))),
        (np.full(4, np.nan), np.zeros((4, 1))),
        (np.zeros(4), np.full((4, 1), np.inf)),
    ],
)
def test_faulty_judgements(objective, measures, monkeypatch):
    monkeypatch.setattr(toy.Cart, "judge", lambda *_: (objective, measures))
    with refused(r"objective \[4\] and measures \[4, 1\], all finite"):
        judge_rows(toy.Cart(), np.zeros((4, 2), toy.Cart.columns), 5.0)


@pytest.mark.parametrize(
    ("holder", "document", "match"),
    [
        (toy.Cart, {"seed": 1}, "simulator: 'seed' .* without .*shard_rows"),
        (toy.Winds, {"columns": 1}, "simulator: 'columns' .* without .*families"),
        (toy.Winds, {"settings": 1}, "simulator: 'settings' .* without "),
        (
            toy.Winds,
            {"horizon_s": 1},
            "simulator: 'horizon_s' .* without .*min_survival_s",
        ),
        (toy.Cart, {"mass": np.float32(1.0)}, "JSON values .*float32"),
        (toy.Cart, {"mass": np.nan}, "JSON values"),
    ],
)
def test_documents_keep_to_their_own_keys_and_to_json(
    holder, document, match, monkeypatch
):
    whole = document if holder is toy.Winds else {"settings": 0} | document
    monkeypatch.setattr(holder, "document", lambda *_: dict(whole))
    with refused(match):
        specification().document  # noqa: B018


def test_a_simulator_without_measures_has_no_repertoire(monkeypatch):
    monkeypatch.setattr(toy.Cart, "measures", {})
    with refused("a simulator that has measures"):
        specification(repertoire=REPERTOIRE)


@pytest.mark.parametrize("name", SIMULATORS)
def test_simulators_of_this_project_are_found_by_name(name):
    assert find_simulator(name).name == name
    assert known_simulator({}) is find_simulator("walker")


def test_machines_differ_by_the_simulators_own_batch(monkeypatch):
    kind = own_kind(toy.Cart())
    assert list(kind) == ["canary", "processor", CART, "numpy"]
    assert own_kind(toy.Cart(mass_kg=2.0)) == kind
    monkeypatch.setattr(toy.Cart, "canary", lambda self: np.ones(2, self.columns))
    assert own_kind(toy.Cart()) != kind


@pytest.mark.slow
def test_a_file_of_the_working_directory_is_a_simulator_of_the_command(tmp_path):
    """Worker processes find it, too."""
    shutil.copy(toy.__file__, tmp_path / "my_robot.py")
    text = "samples = 40\nshard_rows = 8\nseed = 4\nwind = [0.5, 1.5]\n"
    text += "simulator = {name = 'my_robot:Cart', mass_kg = 2.0}\n"
    (tmp_path / "cart.toml").write_text(text)
    words = ("-m", "taichi_nmm", "precompute", "--config", "cart.toml")
    printed(*words, "--workers", "2", cwd=tmp_path)
    store = open_store(tmp_path / "out" / "cart", verify=True)
    assert store.specification["simulator"] == "my_robot:Cart" and len(store) == 40
    assert np.array_equal(store.points(), sobol_points(4, 0, 40, toy.Cart.parameters))
    done = python(*words, "--arch", "cpu", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith("error: arch: 'cpu'")

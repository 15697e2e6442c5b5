"""Stores with candidates beyond the grid: the search, its files, its rows, and what it refuses."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from storage import open_store
from storage.inputs.config import Table
from storage.points import sobol_points
from storage.pool import Pool
from storage.precompute import precompute
from storage.search import Generation, choose, folded, shares
from storage.specification import GENERATION, STARTS, read_specification
from storage.store_folder import NOT_CHOSEN
from storage.tables import FOOTER_KEY, write_table
from taichi_nmm.parameters import GAINS, lower_bounds, upper_bounds
from tests.cases import refused
from tests.storage import fake
from tests.storage.fake import content

pytest.importorskip("ribs")

FAMILIES = {
    "up": fake.family(settings=3, kind="ramp", segment_m=1.0),
    "down": fake.family(
        settings=2, seed=9, kind="ramp", segment_m=1.0, direction="down"
    ),
}
GENERATIONS = 3
STARTERS = 35  # points of the grid that live long enough to be run on the families
WALKS = 2 * 2 * (STARTERS + GENERATIONS * GENERATION)  # two families, two settings
EVALUATIONS = 2 * 2 * (STARTS + GENERATIONS * GENERATION)
REPERTOIRE = {"evaluations": EVALUATIONS, "settings": 2, "candidates": 20, "seed": 5}


def evolving(**changes):
    repertoire = REPERTOIRE | changes.pop("repertoire", {})
    return fake.specification(families=FAMILIES, repertoire=repertoire, **changes)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    path = tmp_path_factory.mktemp("evolved") / "store"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake.simulate)
        return path, precompute(evolving(), path)


def test_candidates_are_rows_after_the_grid(finished, tmp_path):
    path, summary = finished
    store = open_store(path, verify=True)
    rows = store.numpy()
    assert len(store) == summary.points == 70 and summary.shards == 7 + 3
    assert rows["row"].tolist() == list(range(70))
    assert rows["origin"].tolist() == ["sobol"] * 50 + ["evolved"] * 20
    assert np.array_equal(store.points()[:50], sobol_points(7, 0, 50, GAINS))
    assert np.all(
        (store.points() >= lower_bounds()) & (store.points() <= upper_bounds())
    )
    assert len(np.unique(store.points(), axis=0)) == 70
    assert [footer["rows"] for footer in store.footers] == [8] * 6 + [2, 8, 8, 4]
    for family in ("up", "down"):  # run like the points of the grid
        assert np.array_equal(rows[f"{family}_evaluated"], rows["duration_s"] >= 3.0)
        assert np.all(
            (rows[f"{family}_phi_printed_mean"] > 0) == rows[f"{family}_evaluated"]
        )
    precompute(fake.specification(families=FAMILIES), tmp_path / "plain")
    plain = open_store(tmp_path / "plain")  # whose grid is the same
    assert plain.columns == tuple(name for name in store.columns if name != "origin")
    assert plain.table().equals(store.table(plain.columns).slice(0, 50))
    grown = dict.fromkeys(("columns", "repertoire"))
    assert store.specification | grown == plain.specification | grown
    assert not (tmp_path / "plain" / "repertoire.parquet").exists()


def test_the_repertoire_says_what_was_tried_and_whence_a_row_comes(finished):
    path, summary = finished
    tried = pq.read_table(path / "repertoire.parquet").to_pydict()
    rows, walked = np.array(tried["row"]), np.array(tried["walked_fraction"])
    assert (
        walked[rows != NOT_CHOSEN].mean()
        > walked[np.array(tried["generation"]) == 0].mean()
    )
    assert summary.walks_searched == WALKS == 2 * len(rows)
    assert sorted(rows[rows != NOT_CHOSEN]) == list(range(50, 70))
    gains = open_store(path).points()
    for index in np.flatnonzero(rows != NOT_CHOSEN):
        assert tried["generation"][index] > 0
        assert tried["K_GAS"][index] == gains[rows[index], 0]
    families = np.array(tried["family"])[rows != NOT_CHOSEN]
    assert np.unique(families).tolist() == ["down", "up"]
    assert sorted(file.name for file in path.iterdir() if "search" in file.name) == []


@pytest.mark.slow
def test_two_runs_on_any_executor_are_the_same_bytes(finished, tmp_path):
    seen = []
    with ThreadPoolExecutor(3) as executor:  # where the fake simulator is seen
        precompute(
            evolving(), tmp_path / "b", progress=seen.append, pool=Pool(executor, 3)
        )
        # more than points
        precompute(evolving(), tmp_path / "c", pool=Pool(executor, 200))
    assert content(tmp_path / "b") == content(tmp_path / "c") == content(finished[0])
    assert seen == sorted(seen) and seen[0] == 0
    assert seen[-1] == 70 + WALKS <= evolving().work
    before = content(finished[0])
    seen.clear()
    summary = precompute(evolving(), finished[0], progress=seen.append)
    assert (summary.points_computed, summary.walks_searched) == (0, 0)
    assert content(finished[0]) == before and seen == sorted(seen)


@pytest.mark.parametrize(
    "after", [7 * 3 - 1, 7 * 3 + 1, 7 * 3 + 6, 7 * 3 + 8, 7 * 3 + 8 + 4]
)
def test_a_stopped_run_goes_on_alike(finished, tmp_path, after):
    """In the grid's last shard, in the search, and in the candidates' shards."""
    path = tmp_path / "store"
    fake.interrupt(after, evolving(), path)
    summary = precompute(evolving(), path)
    assert content(path) == content(finished[0])
    sizes = [STARTERS, STARTERS, *[GENERATION] * 6]  # a call of the simulator each
    assert summary.walks_searched == WALKS - 2 * sum(sizes[: max(0, after - 7 * 3)])


@pytest.mark.parametrize("damaged", ["repertoire.parquet", "part-00008.parquet"])
def test_damage_is_found_and_mended(finished, tmp_path, damaged):
    path = Path(shutil.copytree(finished[0], tmp_path / "store"))
    fake.flip_a_bit(path / damaged)
    summary = precompute(evolving(), path)
    assert content(path) == content(finished[0])
    assert (summary.walks_searched > 0) == (damaged == "repertoire.parquet")


def other_points(file):
    """As on a machine whose search differs in the last bits."""
    table = pq.read_table(file, partitioning=None)
    moved = pa.array(np.nextafter(table["K_GAS"].to_numpy(), 0.0))
    place = table.column_names.index("K_GAS")
    footer = json.loads(table.schema.metadata[FOOTER_KEY])
    write_table(file, table.set_column(place, "K_GAS", moved), footer)


@pytest.mark.parametrize("damage", [fake.flip_a_bit, other_points])
def test_odd_generation(finished, tmp_path, damage):
    path = tmp_path / "store"
    fake.interrupt(7 * 3 + 6, evolving(), path)
    files = sorted(path.glob("search-*.parquet"))
    assert len(files) == 6
    damage(files[1])
    assert precompute(evolving(), path).walks_searched > 2 * 2 * GENERATION
    assert content(path) == content(finished[0])


def test_fresh_starts_over(tmp_path):
    path = tmp_path / "store"
    fake.interrupt(7 * 3 + 3, evolving(), path)
    precompute(fake.specification(), path, fresh=True)
    assert not [
        name for name in content(path) if "search" in name or "repertoire" in name
    ]


def test_candidates_are_tried_on_settings_of_their_own():
    specification = evolving()
    for trial in specification.repertoire.trials:
        (own,) = (
            family for family in specification.families if family.name == trial.name
        )
        assert len(trial.worlds.bodies) == 2 and trial.horizon_s == own.horizon_s
        assert not np.any(
            np.isin(trial.worlds.bodies.mass_kg, own.worlds.bodies.mass_kg)
        )
    other = evolving(repertoire={"seed": 6}).repertoire
    assert other.document != specification.repertoire.document


def test_a_share_holds_the_best_and_the_search_is_longest_where_the_grid_survives_least():
    rng = np.random.default_rng(1)

    def generation(count):
        spread = rng.uniform([0.4, 0.3, 0.5], [2.0, 1.0, 1.8], (count, 3))
        return Generation(rng.random((count, 16)), rng.random(count), spread)

    found = {name: [generation(10), generation(60)] for name in ("a", "b", "c")}
    found["c"][1].objective[0] = 2.0  # of the first point after the grid's
    chosen = choose(found, {"a": 10, "b": 31, "c": 1}, evolving().simulator)
    assert [len(numbers) for numbers in chosen.values()] == [10, 31, 1]
    assert chosen["c"].tolist() == [10]
    for name, numbers in chosen.items():
        objective = np.concatenate([one.objective for one in found[name]])
        assert numbers.min() >= 10 and len(set(numbers)) == len(numbers)
        assert np.all(np.diff(objective[numbers]) <= 0)
        assert numbers[0] == 10 + np.argmax(objective[10:])
    assert shares(10, {"a": 0.0, "b": 0.0}) == {"a": 5, "b": 5}
    assert shares(12, {"a": 0.01, "b": 0.9, "c": 0.45}) == {"a": 1, "b": 7, "c": 4}
    assert sum(shares(101, {"a": 0.3, "b": 0.3, "c": 0.7}).values()) == 101
    assert shares(2, {"a": 0.0, "b": 1.0}) == {"a": 1, "b": 1}
    points = np.array([-0.1, 0.0, 0.3, 1.0, 1.2, 2.1])
    assert folded(points) == pytest.approx([0.1, 0.0, 0.3, 1.0, 0.8, 0.1])


def test_what_makes_no_repertoire(tmp_path, monkeypatch):
    weak = {"up": FAMILIES["up"] | {"min_survival_s": 5.0}}
    falls = fake.configuration(samples=1, seed=10, families=weak, repertoire=REPERTOIRE)
    store = read_specification(Table(falls))
    with refused(r"^samples: .*family up"):
        precompute(store, tmp_path / "store")
    least = 2 * (STARTS + GENERATION) * 2  # two families, two settings
    shortest = evolving(repertoire={"evaluations": least}).repertoire
    assert shortest.generations == 2
    with refused(f"at least {least} for 20 candidates"):
        evolving(repertoire={"evaluations": least - 1})
    monkeypatch.setattr("storage.specification.LIBRARY", "no_such_library")
    with refused("pip install"):
        _ = evolving().document

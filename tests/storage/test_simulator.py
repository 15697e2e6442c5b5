"""The seam: any simulator has a store, here a cart of three parameters in one file."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from storage import merge, open_store
from storage.points import sobol_points
from storage.pool import local_pool, own_kind
from storage.precompute import precompute
from storage.simulator import SIMULATORS, Simulator, find_simulator, known_simulator
from storage.specification import GENERATION, STARTS, Specification, read_specification
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError
from tests.storage import toy

CART = "tests.storage.toy:Cart"
CONFIGURATION: dict[str, Any] = {
    "simulator": CART,
    "samples": 60,
    "shard_rows": 16,
    "seed": 4,
    "wind": [0.5, 1.5],
    "simulation": {"mass_kg": 2.0},
    "families": {
        "gale": {"settings": 3, "min_survival_s": 4.0, "seed": 1, "wind": [1.0, 3.0]},
        "storm": {
            "settings": 2, "min_survival_s": 4.0, "seed": 2, "wind": [3.0, 4.0],
            "after": "gale", "min_survived_fraction": 0.5,
        },
    },
}  # fmt: skip
REPERTOIRE = {"evaluations": STARTS + 2 * GENERATION, "settings": 1, "candidates": 20}


def specification(**changes: Any) -> Specification:
    return read_specification(Table(CONFIGURATION | changes))


def content(path: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in path.iterdir()}


@pytest.fixture
def stopped_in_run(monkeypatch: pytest.MonkeyPatch) -> Callable[[int, Specification, Path], None]:
    """A store of which a call of the simulator is interrupted."""

    def stop(number: int, asked: Specification, path: Path) -> None:
        before, run = len(toy.runs), toy.Cart.run

        def stopping(self: toy.Cart, *args: Any) -> Any:
            if len(toy.runs) - before == number:
                raise KeyboardInterrupt
            return run(self, *args)

        with monkeypatch.context() as patch:
            patch.setattr(toy.Cart, "run", stopping)
            with pytest.raises(KeyboardInterrupt):
                precompute(asked, path)

    return stop


def test_a_store_of_another_simulator_is_filled_and_read(tmp_path: Path) -> None:
    summary = precompute(specification(), tmp_path / "store")
    store = open_store(tmp_path / "store", verify=True)
    rows = store.numpy()
    assert store.gain_names == ("thrust", "drag", "steer")
    assert store.families == ("gale", "storm")
    points = sobol_points(4, 0, 60, toy.Cart.parameters)
    assert np.array_equal(store.gains(), points)
    assert np.array_equal(rows["speed"], (points[:, 0] / points[:, 1] / 2.0).astype(np.float32))
    assert set(rows["end_reason"]) == {"arrived", "blown off"}
    assert summary.alive_at_horizon == np.count_nonzero(rows["end_reason"] == "arrived")
    gale, storm = rows["gale_evaluated"], rows["storm_evaluated"]
    assert np.array_equal(gale, rows["duration_s"] >= 4.0)
    assert np.array_equal(storm, gale & (rows["gale_survived_fraction_mean"] >= 0.5))
    assert 0 < storm.sum() < gale.sum() < 60
    winds = specification().families[0].worlds
    survived = np.exp(np.minimum(0.5 - winds * np.abs(points[gale, 2:]), 0.0))
    np.testing.assert_allclose(rows["gale_survived_fraction_mean"][gale], survived.mean(axis=1))
    np.testing.assert_allclose(rows["gale_survived_fraction_sd"][gale], survived.std(axis=1))
    assert {footer["engine"] for footer in store.footers} == {"cart"}
    assert (
        merge(tmp_path / "store", tmp_path / "merged.parquet")
        .table()
        .equals(store.table().combine_chunks())
    )


def test_the_document_names_the_simulator_and_its_worlds() -> None:
    document = specification().document
    assert (document["simulator"], document["code_version"]) == ("cart", "1")
    assert document["simulation"] == {"duration_s": 5.0, "mass_kg": 2.0}
    assert document["wind"] == [0.5, 1.5] and document["families"]["storm"]["wind"] == [3.0, 4.0]
    assert list(document["gains"]) == ["thrust", "drag", "steer"]
    assert specification(simulation={"mass_kg": 3.0}).hash != specification().hash


@pytest.mark.parametrize("number", [0, 5, 9])
def test_a_store_that_was_stopped_goes_on_to_the_same_bytes(
    number: int, tmp_path: Path, stopped_in_run: Callable[[int, Specification, Path], None]
) -> None:
    precompute(specification(), tmp_path / "whole")
    stopped_in_run(number, specification(), tmp_path / "store")
    before = len(toy.runs)
    precompute(specification(), tmp_path / "store")
    assert len(toy.runs) - before < 12 + (number == 0)  # four shards, on three settings each
    assert content(tmp_path / "store") == content(tmp_path / "whole")


def test_a_repertoire_of_another_simulator(
    tmp_path: Path, stopped_in_run: Callable[[int, Specification, Path], None]
) -> None:
    pytest.importorskip("ribs")
    families = {"gale": CONFIGURATION["families"]["gale"]}
    asked = specification(samples=300, shard_rows=300, families=families, repertoire=REPERTOIRE)
    precompute(asked, tmp_path / "whole")
    store = open_store(tmp_path / "whole")
    assert store.numpy(["origin"])["origin"].tolist() == ["sobol"] * 300 + ["evolved"] * 20
    tried = pq.read_table(tmp_path / "whole" / "repertoire.parquet").to_pydict()
    way, generation = np.array(tried["way"]), np.array(tried["generation"])
    assert way[generation == 2].max() > way[generation == 0].max() > 0.0
    assert "tried_speed" in tried
    stopped_in_run(4, asked, tmp_path / "store")
    assert len(list((tmp_path / "store").glob("search-gale-*"))) == 2
    precompute(asked, tmp_path / "store")
    assert content(tmp_path / "store") == content(tmp_path / "whole")


@pytest.mark.slow
def test_processes_compute_the_same_bytes(tmp_path: Path) -> None:
    precompute(specification(), tmp_path / "one")
    with local_pool(2) as pool:
        precompute(specification(), tmp_path / "two", pool=pool)
    assert content(tmp_path / "one") == content(tmp_path / "two")


def test_a_simulators_own_tables_are_checked() -> None:
    gale = CONFIGURATION["families"]["gale"]
    for changes, field in (
        ({"simulation": {"mass_kg": 0.0}}, "simulation.mass_kg"),
        ({"simulation": {"arch": "cpu"}}, "simulation.arch"),
        ({"wind": [2, 1]}, "wind"),
        ({"families": {"gale": gale | {"wind": 3}}}, "families.gale.wind"),
        ({"families": {"speed": gale}}, "families"),
        ({"terrain": {"kind": "flat"}}, "terrain"),
        ({"searched": ["thrust"]}, "searched"),
    ):
        with pytest.raises(InputError) as caught:
            specification(**changes)
        assert caught.value.field == field


@pytest.mark.parametrize(
    "name",
    ["", "cart", "tests.storage.toy", "tests.storage.toy:Bicycle", "no.module:Cart", ":Cart"],
)
def test_a_simulator_that_is_not_there_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"package\.module:Class") as caught:
        specification(simulator=name)
    assert caught.value.field == "simulator"


@pytest.mark.parametrize("name", ["duration_s", "end_reason", "survived_fraction"])
def test_a_simulator_without_a_needed_column_is_refused(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fewer = [each for each in toy.Cart.columns.names or () if each != name]
    monkeypatch.setattr(toy.Cart, "columns", toy.Cart.columns[fewer])
    with pytest.raises(InputError, match=name):
        specification()


def test_a_simulator_without_measures_has_no_repertoire(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(toy.Cart, "measures", {})
    with pytest.raises(InputError, match="a simulator that has measures"):
        specification(repertoire=REPERTOIRE)


def test_no_code_is_imported_that_a_file_names(tmp_path: Path) -> None:
    """A store may come from anybody: of simulators, only those of this project are looked up."""
    precompute(specification(), tmp_path / "store")
    with pytest.raises(InputError, match=r"store\.simulator: 'cart' .* walker"):
        open_store(tmp_path / "store").require_bounds()
    with pytest.raises(InputError):
        known_simulator({"simulator": CART})


@pytest.mark.parametrize("name", SIMULATORS)
def test_simulators_of_this_project_are_found_by_name(name: str) -> None:
    found: type[Simulator] = find_simulator(name)
    assert found.name == name
    assert known_simulator({}) is find_simulator("walker")


def test_machines_are_told_apart_by_the_simulators_own_batch() -> None:
    kind = own_kind(toy.Cart())
    assert list(kind) == ["canary", "processor", "taichi-nmm", "numpy"]
    assert own_kind(toy.Cart()) == kind != own_kind(toy.Cart(mass_kg=2.0))

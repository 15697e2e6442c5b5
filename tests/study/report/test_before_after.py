"""The walks before and after: which trials are shown, on which ground, and how."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from study.experiment.identity import document, documented_experiment
from study.pictures.strip import Shown
from study.report.before_after import Pair, before_and_after, choose, write_strips
from study.report.runs import Results, read_results
from taichi_nmm.parameters import GAIN_NAMES
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, Result
from taichi_nmm.terrain import Terrain, ramp, rough
from tests.study import synthetic_gait
from tests.study.experiment.fake_results import experiment
from tests.study.report import synthetic

FELL_COST, WALKED_COST = 0.5, 0.012


def write(folder: Path, walks: dict[str, list[list[int]]]) -> Results:
    """A comparison in which the given trials of each run of each arm walk, of eight."""
    arms = dict.fromkeys(walks, (0.0, 0.0))
    runs = len(next(iter(walks.values())))
    synthetic.write(folder, arms, runs, 8, name="tiny")
    columns = pq.read_table(folder / "trials.parquet").to_pydict()
    for row in range(len(columns["arm"])):
        trial = columns["trial"][row]
        walked = trial in walks[columns["arm"][row]][columns["run"][row]]
        columns["walked"][row] = walked
        columns["cost"][row] = (WALKED_COST if walked else FELL_COST) + 0.001 * trial
    pq.write_table(pa.table(columns), folder / "trials.parquet")
    return read_results(folder)


@pytest.mark.parametrize(("walks", "shown"), [
    ({"worlds": [[0], [4, 6]], "dog": [[5], [7]]}, [(1, "worlds", 0), (1, "worlds", 4)]),
    ({"worlds": [[0], [1]], "dog": [[5], []], "tpe": [[], []]}, [(0, "dog", 0), (0, "worlds", 0)]),
    ({"tpe": [[3], [3]], "random": [[], [5]]}, [(0, "tpe", 0), (0, "tpe", 3)]),
], ids=["a first trial of our best that fell", "our best walks at once", "without our best"],
)  # fmt: skip
def test_which_trials_are_shown(tmp_path: Path, walks: dict[str, Any], shown: list[Any]) -> None:
    chosen = choose(write(tmp_path, walks), GAIN_NAMES)
    assert chosen is not None
    assert [(row["run"], row["arm"], row["trial"]) for row in chosen] == shown


def test_without_a_walker_there_is_nothing_to_show(tmp_path: Path) -> None:
    results = write(tmp_path / "data", {"worlds": [[], []], "dog": [[], []]})
    assert choose(results, GAIN_NAMES) is None
    assert before_and_after(results, experiment()) is None


def test_walks_of_the_tables_gains_and_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = write(tmp_path / "data", {"worlds": [[0], [4]], "dog": [[5], [7]]})
    table = pq.read_table(tmp_path / "data" / "trials.parquet").to_pylist()
    seen = {}

    def simulate(gains: np.ndarray, **options: object) -> Result:
        seen.update(options, gains=gains)
        rows = np.zeros(2, RESULT_DTYPE)
        rows["end_reason"] = (FELL, COMPLETED)
        rows["duration_s"], rows["distance_m"] = (2.0, 100.0), (1.5, 130.0)
        rows["mean_speed_mps"] = 1.3
        return Result(rows, (synthetic_gait.walk(2.0), synthetic_gait.walk(8.0)))

    monkeypatch.setitem(vars(taichi_nmm), "simulate", simulate)
    made = experiment()
    documented = documented_experiment(json.loads(json.dumps(document(made, ()))))
    pair = before_and_after(results, documented)
    assert pair is not None and pair.run == 1
    for number, trial in enumerate((0, 4)):
        key = ("worlds", 1, trial)
        row = next(row for row in table if (row["arm"], row["run"], row["trial"]) == key)
        np.testing.assert_array_equal(seen["gains"][number], [row[name] for name in GAIN_NAMES])
    assert seen["bodies"].mass_kg[0].tolist() == made.body(1).mass_kg[0].tolist()
    assert pair.first.title == "Before: worlds, trial 1: fell after 2 s, 1.5 m"
    assert pair.second.title == "After: worlds, trial 5: 100 s, 130 m at 1.30 m/s"


@pytest.mark.parametrize("terrain", [rough(1, flat_start_m=1.0), ramp()], ids=["rough", "ramp"])
def test_strips_are_drawn_on_the_ground(tmp_path: Path, terrain: Terrain) -> None:
    before = Shown("before", "before: somebody", synthetic_gait.walk(0.3, 50.0))
    after = Shown("after", "after: somebody", synthetic_gait.walk(12.0, 50.0))
    files = write_strips(tmp_path, "made-up", Pair(0, terrain, before, after))
    assert [file.name for file in files] == ["strips.png", "strips.svg"]
    assert min(file.stat().st_size for file in files) > 50_000

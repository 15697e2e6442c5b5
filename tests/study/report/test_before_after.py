"""The walks before and after: which trials are shown, on which ground, and how."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from study.experiment.experiment import Experiment, read_experiment
from study.experiment.identity import document, documented_experiment
from study.experiment.stores import store_digest
from study.report.before_after import Pair, Shown, before_and_after, choose
from study.report.facts import facts, known_stores
from study.report.runs import Results, read_results
from study.report.strips import write_strips
from taichi_nmm.parameters import GAIN_NAMES
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, Result
from taichi_nmm.terrain import ramp, rough
from tests.study import synthetic_gait
from tests.study.report import synthetic

CONFIG = """
name = "tiny"
seed = 3
[objective]
cost = "smooth"
[body]
disturbance = 0.15
[terrain]
kind = "rough"
"""
FELL_COST, WALKED_COST = 0.5, 0.012


def experiment(folder: Path, text: str = CONFIG) -> Experiment:
    folder.mkdir(exist_ok=True)
    (folder / "tiny.toml").write_text(text)
    return read_experiment(folder / "tiny.toml")


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


def test_before_is_a_first_trial_of_our_best_that_fell(tmp_path: Path) -> None:
    results = write(tmp_path, {"best": [[0], [4, 6]], "dog": [[5], [7]]})
    chosen = choose(results, GAIN_NAMES)
    assert chosen is not None
    run, before, after = chosen
    assert (run, before.arm, before.trial) == (1, "best", 0)
    assert (after.arm, after.trial) == ("best", 4)


def test_where_our_best_walks_at_once_the_papers_method_is_before(tmp_path: Path) -> None:
    results = write(tmp_path, {"best": [[0], [1]], "dog": [[5], []], "random": [[], []]})
    chosen = choose(results, GAIN_NAMES)
    assert chosen is not None
    run, before, after = chosen
    assert (run, before.arm, before.trial, after.arm, after.trial) == (0, "dog", 0, "best", 0)


def test_without_our_best_the_best_arm_is_after(tmp_path: Path) -> None:
    results = write(tmp_path, {"tpe": [[3], [3]], "random": [[], [5]]})
    chosen = choose(results, GAIN_NAMES)
    assert chosen is not None and chosen[2].arm == "tpe"


def test_without_a_walker_there_is_nothing_to_show(tmp_path: Path) -> None:
    results = write(tmp_path / "data", {"best": [[], []], "dog": [[], []]})
    assert choose(results, GAIN_NAMES) is None
    assert before_and_after(results, experiment(tmp_path / "configs")) is None


def test_both_walks_are_of_the_gains_and_the_run_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = write(tmp_path / "data", {"best": [[0], [4]], "dog": [[5], [7]]})
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
    made = experiment(tmp_path / "configs")
    documented = documented_experiment(json.loads(json.dumps(document(made, ()))))
    assert documented is not None
    pair = before_and_after(results, documented)
    assert pair is not None and pair.run == 1
    for number, trial in enumerate((0, 4)):
        row = next(
            row for row in table if (row["arm"], row["run"], row["trial"]) == ("best", 1, trial)
        )
        np.testing.assert_array_equal(seen["gains"][number], [row[name] for name in GAIN_NAMES])
    assert seen["bodies"].mass_kg[0].tolist() == made.body(1).mass_kg[0].tolist()
    assert pair.before.title == "Before: best combination, trial 1: fell after 2 s, 1.5 m"
    assert pair.after.title == "After: best combination, trial 5: 100 s, 130 m at 1.30 m/s"


@pytest.mark.parametrize("ground", ["rough", "ramp"])
def test_strips_are_drawn_on_the_ground(tmp_path: Path, ground: str) -> None:
    terrain = rough(1, flat_start_m=1.0) if ground == "rough" else ramp()
    walks = [
        Shown(when, f"{when}: somebody", synthetic_gait.walk(seconds, 50.0))
        for when, seconds in (("before", 0.3), ("after", 12.0))
    ]
    files = write_strips(tmp_path, "made-up", Pair(0, terrain, *walks))
    assert [file.name for file in files] == ["strips.png", "strips.svg"]
    assert min(file.stat().st_size for file in files) > 50_000


def test_facts_of_several_sessions(tmp_path: Path) -> None:
    folder = synthetic.write(tmp_path, {"dog": (0.1, 0.0)}, 2, 3)
    machine = {"system": "Linux", "cores": 2}
    sessions = [
        {
            "started": f"2026-11-{day}T10:00:00+00:00",
            "trials": 3,
            "wall_s": 90.0,
            "machine": machine,
        }
        for day in (21, 22)
    ]
    (folder / "run.json").write_text(json.dumps({"sessions": sessions}))
    found = facts(read_results(folder))
    assert found["date"] == "2026-11-21 to 2026-11-22"
    assert found["wall time"] == "3.0 min for 6 trials in 2 sessions"
    assert found["machine"] == "system Linux, cores 2"
    (folder / "run.json").unlink()
    assert "date" not in facts(read_results(folder))


def test_stores_that_still_are_what_the_results_were_made_with_are_known(tmp_path: Path) -> None:
    paths = {name: tmp_path / f"{name}.parquet" for name in ("flat", "mild", "ramps")}
    for name in ("flat", "mild"):
        paths[name].write_text(name)
    digests = {key: store_digest(paths["flat"]) for key in paths}
    made = write(tmp_path / "tiny", {"dog": [[5]]})

    def known(*sessions: dict[str, str]) -> dict[str, Path]:
        noted = [{"trials": 1}, *({"stores": stores} for stores in sessions), {"trials": 0}]
        return known_stores(replace(made, facts={"stores": digests, "sessions": noted}))

    where = {key: str(path) for key, path in paths.items()}
    assert known(where) == {"flat": paths["flat"]}
    assert known({"flat": "nowhere"}, where) == {"flat": paths["flat"]}
    assert known(where, {"flat": "nowhere"}) == {}  # the latest counts
    assert known() == known_stores(replace(made, facts={})) == {}

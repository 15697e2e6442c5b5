"""Reading a comparison's folder: arrays, checkpoints, what is unfinished, what is refused."""

import json
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from storage.inputs.errors import InputError
from study.experiment.experiment import store_digest
from study.report.runs import known_stores, read_results, runs_of
from tests.cases import asset, refused
from tests.study.report import synthetic

TWO = {"dog": (0.02, 0.002), "random": (0.01, 0.0)}
RUNS, TRIALS = 4, 6
COUNT = len(TWO) * RUNS * TRIALS


@pytest.fixture
def folder(tmp_path):
    return synthetic.write(tmp_path / "small", TWO, RUNS, TRIALS)


@pytest.fixture
def table(folder):
    return pq.read_table(folder / "trials.parquet")


def rewrite(folder, table):
    pq.write_table(table, folder / "trials.parquet")


def refusal(folder):
    with pytest.raises(InputError) as caught:
        read_results(folder)
    return str(caught.value)


def test_arrays_are_those_of_the_table(comparison, results):
    table = pq.read_table(comparison / "trials.parquet")
    assert list(results.arms) == sorted(synthetic.ARMS)
    dog = table.filter(pc.equal(table["arm"], "dog"))
    seventh = dog.filter(pc.equal(dog["run"], 7))
    arm = results.arms["dog"]
    assert arm.best.shape == arm.walks.shape == (50, 100)
    np.testing.assert_array_equal(arm.best[7], seventh["best_cost"].to_numpy())
    walked = np.flatnonzero(seventh["walked"].to_numpy())
    assert arm.first_walker[7] == (walked[0] + 1 if len(walked) else np.inf)
    assert results.complete and results.found == results.planned == 50 * 100 * len(
        synthetic.ARMS
    )
    assert (results.name, results.cost) == ("made-up", "smooth")


def test_the_order_of_the_rows_does_not_matter(folder, table):
    known = read_results(folder).arms
    shuffled = table.take(np.random.default_rng(0).permutation(len(table)))
    rewrite(folder, shuffled)
    # of the file, and in memory
    for found in (read_results(folder).arms, runs_of(shuffled)):
        assert list(found) == list(known)
        for arm, theirs in known.items():
            np.testing.assert_array_equal(found[arm].best, theirs.best)
            assert (found[arm].walkers, found[arm].found) == (
                theirs.walkers,
                theirs.found,
            )


def test_a_checkpoint_with_more_trials_counts(folder, table):
    late = pc.and_(pc.equal(table["run"], 3), pc.greater_equal(table["trial"], 4))
    rewrite(folder, table.filter(pc.invert(late)))
    results = read_results(folder)  # runs count as far as all have come
    assert results.arms["dog"].best.shape == (4, 4) and not results.complete
    (folder / "arms").mkdir()
    pq.write_table(
        table.filter(pc.equal(table["arm"], "dog")), folder / "arms" / "dog.parquet"
    )
    (folder / "arms" / ".random.parquet.1.tmp").write_bytes(b"half")
    rewrite(folder, table.filter(pc.less(table["trial"], 2)))
    results = read_results(folder)
    assert results.arms["dog"].trials == 6
    assert results.arms["random"].trials == 2
    assert (results.complete, results.found, results.planned) == (False, 24 + 8, 48)
    (folder / "trials.parquet").unlink()
    assert list(read_results(folder).arms) == ["dog"]


def test_stores_that_still_are_what_the_results_were_made_with_are_known(tmp_path):
    paths = {name: tmp_path / f"{name}.parquet" for name in ("flat", "mild", "ramps")}
    for name in ("flat", "mild"):
        paths[name].write_text(name)
    digests = {key: store_digest(paths["flat"]) for key in paths}
    made = read_results(
        synthetic.write(tmp_path / "made-up", {"dog": (0.1, 0.0)}, 1, 3)
    )

    def known(*sessions):
        noted = [
            {"trials": 1},
            *({"stores": stores} for stores in sessions),
            {"trials": 0},
        ]
        return known_stores(replace(made, facts={"stores": digests, "sessions": noted}))

    where = {key: str(path) for key, path in paths.items()}
    assert known(where) == {"flat": paths["flat"]}
    assert known({"flat": "nowhere"}, where) == {"flat": paths["flat"]}
    assert known(where, {"flat": "nowhere"}) == {}  # the latest counts
    assert known() == known_stores(replace(made, facts={})) == {}


def test_no_trials_one_less_or_one_more(folder, table, tmp_path):
    assert "nowhere" in refusal(tmp_path / "nowhere")
    rewrite(folder, table.slice(0, 0))
    for empty in (folder, tmp_path):
        message = refusal(empty)
        assert (
            message.startswith("folder: ") and "trials.parquet, with trials" in message
        )
    rewrite(folder, table.drop_columns(["best_cost"]))
    assert "column: 'best_cost'" in refusal(folder)
    (folder / "trials.parquet").write_bytes(b"PAR1 and no more")
    message = refusal(folder)
    assert message.startswith("trials.parquet: ") and "readable" in message
    with refused("trials: 'arm dog'"):
        runs_of(table.slice(1))
    for broken in (table.slice(1), pa.concat_tables([table, table.slice(3, 1)])):
        rewrite(folder, broken)
        assert "arm dog" in refusal(folder)


@pytest.mark.parametrize("text", ["[]", "5", "null", '"a"', "true", "{", "[" * 100_000])
@pytest.mark.parametrize("name", ["experiment.json", "run.json"])
def test_documents_that_are_no_objects(folder, name, text):
    (folder / name).write_text(text)
    assert refusal(folder).startswith(f"{name}: ")


@pytest.mark.parametrize(
    "part",
    [
        *asset("bad-facts.toml")["parts"],
        {"sessions": [None]},
        {"simulation": {"duration_s": 10**400}},
        {"sessions": [{"trials": 10**400}]},
        {"sessions": None},
        {"sessions": [{"stores": {"flat": None}}]},
        {"terrain": None},
        {"sessions": [{"wall_s": None}]},
        {"simulation": {"duration_s": None}},
    ],
)
def test_parts_of_another_form(folder, part):
    name = "run.json" if "sessions" in part else "experiment.json"
    (folder / name).write_text(json.dumps(part))
    assert refusal(folder).startswith(f"{name}: {next(iter(part))}")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("arm", [None, *["dog"] * (COUNT - 1)]),
        ("arm", ["<script>"] * COUNT),
        ("arm", ["a|b"] * COUNT),
        ("arm", ["$\\frac$"] * COUNT),
        ("arm", [1] * COUNT),
        ("arm", [None] * COUNT),
        ("experiment", ["a\nb"] * COUNT),
        ("run", [None, *[0] * (COUNT - 1)]),
        ("run", [-1] * COUNT),
        ("trial", [0.5] * COUNT),
        ("walked", [1] * COUNT),
        ("cost", [np.nan] * COUNT),
        ("cost", [1e308] * COUNT),
        ("best_cost", [np.nan, *[1.0] * (COUNT - 1)]),
        ("best_cost", [np.inf] * COUNT),
        ("best_cost", ["cheap"] * COUNT),
    ],
)
def test_columns_of_another_kind(folder, table, name, values):
    rewrite(
        folder,
        table.set_column(table.schema.get_field_index(name), name, pa.array(values)),
    )
    assert refusal(folder).startswith(f"trials.parquet: {name}: ")

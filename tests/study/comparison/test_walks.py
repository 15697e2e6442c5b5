"""A walk of a robot is simulated once, whichever arms try it and whenever; nothing else changes."""

import pyarrow as pa
import pytest

from study.comparison.block import Block, advance
from study.comparison.folder import PROPOSAL_TIME, STATE_SCHEMA, in_order
from study.experiment.experiment import Experiment
from taichi_nmm.parameters import GAIN_NAMES
from tests.study import fake_walker

STUDIES = tuple(
    (arm, run)
    for run in range(2)
    for arm in ("best", "score-first-diverse", "best-worlds", "score-first-worlds", "random")
)
NOTHING = STATE_SCHEMA.empty_table()
TRIALS = 8


def sorted_rows(*tables: pa.Table) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = in_order(list(tables)).drop_columns(PROPOSAL_TIME).to_pylist()
    return rows


def different(table: pa.Table) -> int:
    """How many walks of a table have another robot or other gains."""
    return len({tuple(row.values()) for row in table.select(["run", *GAIN_NAMES]).to_pylist()})


def simulated() -> int:
    return sum(len(call["gains"]) for call in fake_walker.calls)


def test_what_several_arms_try_is_simulated_once(toy: Experiment) -> None:
    fake_walker.calls.clear()
    table = advance(Block(toy, STUDIES, NOTHING, TRIALS)).table
    assert simulated() == different(table) < len(table) == TRIALS * len(STUDIES)
    alone = [advance(Block(toy, (study,), NOTHING, TRIALS)).table for study in STUDIES]
    assert sorted_rows(table) == sorted_rows(*alone)


@pytest.mark.parametrize("handed_on", [True, False], ids=["next stretch", "next session"])
def test_walks_of_before_are_known(toy: Experiment, handed_on: bool) -> None:
    whole = advance(Block(toy, STUDIES, NOTHING, TRIALS)).table
    fake_walker.calls.clear()
    first = advance(Block(toy, STUDIES, NOTHING, 3))
    if handed_on:
        block = Block(toy, STUDIES, NOTHING, TRIALS, first.studies, first.walks)
    else:
        block = Block(toy, STUDIES, first.table, TRIALS)
    rest = advance(block).table
    assert sorted_rows(first.table, rest) == sorted_rows(whole)
    assert simulated() == different(whole)


def test_another_robot_is_another_walk(toy: Experiment) -> None:
    fake_walker.calls.clear()
    table = advance(
        Block(toy, (("score-first-diverse", 0), ("score-first-diverse", 1)), NOTHING, 1)
    ).table
    assert table["row"][0] == table["row"][1] and simulated() == 2
    assert table["distance_m"][0] != table["distance_m"][1]

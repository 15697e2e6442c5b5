"""The unit of work: it goes on from where its studies are, and tries a walk once."""

import pickle

import pyarrow as pa
import pytest

from study.experiment.block import Block, advance
from study.experiment.folder import NOTES, PROPOSAL_TIME, in_order
from study.experiment.walker import KEPT
from taichi_nmm.parameters import GAIN_NAMES
from taichi_nmm.result import COMPLETED
from tests.study import fake_walker
from tests.study.experiment.fake_results import STATE_SCHEMA

NOTHING = STATE_SCHEMA.empty_table()


def sorted_rows(*tables):
    """Rows of tables by study, without what no two runs agree upon."""
    rows = in_order(list(tables)).drop_columns(PROPOSAL_TIME).to_pylist()
    return rows


def test_a_table_holds_what_the_simulator_said(toy):
    table = advance(Block(toy, (("random", 0),), NOTHING, 1)).table
    call = fake_walker.calls[-1]
    gains = call.pop("gains")
    said, kept = fake_walker.simulate(gains, **call).rows, toy.rows_of(table)
    for name in (*KEPT, "end_reason"):
        assert kept[name] == said[name]
    assert table.schema.equals(STATE_SCHEMA)
    assert table["walked"].to_pylist() == [bool(said["end_reason"][0] == COMPLETED)]
    assert table[NOTES].to_pylist() == ["{}"]
    dog = (("dog", 0),)
    first = advance(Block(toy, dog, NOTHING, 1))
    again = advance(Block(toy, dog, first.table, 1))
    (told,), (restored,) = (of.studies[0].trials for of in (first, again))
    assert restored.user_attrs == told.user_attrs  # with what its walk showed
    assert restored.user_attrs["shown"] == first.table["phi_printed"].to_pylist()


@pytest.mark.slow
def test_a_block_that_is_handed_on_travels_and_goes_on(toy):
    """All arms: what a library keeps in its trials comes along, what does not pickle stays."""
    studies = tuple((name, 1) for name in fake_walker.ABLE)
    whole = advance(Block(toy, studies, NOTHING, 6)).table
    first = advance(Block(toy, studies, NOTHING, 2))
    handed_on = pickle.loads(pickle.dumps(first.studies))
    rest = advance(Block(toy, studies, NOTHING, 6, handed_on)).table
    assert sorted_rows(pa.concat_tables([first.table, rest])) == sorted_rows(whole)


# Walks that several arms try on one robot.

ALIKE = ("worlds", "bo-ranking", "ranking", "random")
SHARING = tuple((arm, run) for run in range(2) for arm in ALIKE)


def different(table):
    """How many walks of a table have another robot or other gains."""
    return len(
        {tuple(row.values()) for row in table.select(["run", *GAIN_NAMES]).to_pylist()}
    )


def simulated():
    return sum(len(call["gains"]) for call in fake_walker.calls)


@pytest.mark.slow
def test_what_several_arms_try_is_simulated_once(toy):
    """Also when it was tried in the stretch or the session before."""
    fake_walker.calls.clear()
    whole = advance(Block(toy, SHARING, NOTHING, 8)).table
    assert simulated() == different(whole) < len(whole) == 8 * len(SHARING)
    alone = [advance(Block(toy, (study,), NOTHING, 8)).table for study in SHARING]
    assert sorted_rows(whole) == sorted_rows(*alone)
    for next_stretch in (True, False):
        fake_walker.calls.clear()
        first = advance(Block(toy, SHARING, NOTHING, 3))
        known = (
            (NOTHING, 8, first.studies, first.walks)
            if next_stretch
            else (first.table, 8)
        )
        rest = advance(Block(toy, SHARING, *known)).table
        assert sorted_rows(first.table, rest) == sorted_rows(whole)
        assert simulated() == different(whole)

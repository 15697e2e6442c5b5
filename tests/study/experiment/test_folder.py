"""Tables of trials: rows stay with the study that they are of."""

import numpy as np
import pyarrow as pa
import pytest

from study.experiment.arms import ARMS
from study.experiment.folder import as_if_gone_on, by_study
from tests.cases import cases


@pytest.mark.parametrize("seed", range(20))
def test_every_row_is_given_to_its_own_study(seed):
    """Arrow's `group_by` gives groups in an order of its own: with it, labels were swapped."""
    rng = np.random.default_rng(seed)
    count = 2000
    arms, runs = rng.choice(list(ARMS), count), rng.integers(0, 50, count)
    columns = {"arm": arms.tolist(), "run": runs, "trial": np.arange(count)}
    given = list(by_study(pa.table(columns)))
    for arm, run, rows in given:
        assert set(rows["arm"].to_pylist()) == {arm} and set(
            rows["run"].to_pylist()
        ) == {run}
        assert (
            rows["trial"].to_pylist()
            == np.flatnonzero((arms == arm) & (runs == run)).tolist()
        )
    assert sum(len(rows) for _, _, rows in given) == count
    keys = [(arm, run) for arm, run, _ in given]
    assert keys == sorted(set(keys))
    assert list(by_study(pa.table(columns).slice(count))) == []


def trials(*studies):
    """Studies as words, a letter a trial: w walked, f fell."""
    kinds = {
        "arm": pa.string(),
        "run": pa.int32(),
        "trial": pa.int32(),
        "walked": pa.bool_(),
        "cost": pa.float64(),
    }
    rows = [
        (arm, run, trial, letter == "w", run + 0.1 * trial)
        for arm, run, word in studies
        for trial, letter in enumerate(word)
    ]
    named = [dict(zip(kinds, row, strict=True)) for row in rows]
    return pa.Table.from_pylist(named, schema=pa.schema(kinds))


@cases("studies-gone-on.toml", "before", "after")
def test_as_if_gone_on(before, after):
    given, expected = trials(*before), trials(*after)
    for shuffled in (
        given,
        given.take(np.random.default_rng(0).permutation(len(given))),
    ):
        found = as_if_gone_on(shuffled)
        assert found.schema == given.schema
        for name in ("arm", "run", "trial", "walked"):
            assert found[name].to_pylist() == expected[name].to_pylist()
    # What is repeated is the last trial.
    own = {}
    for row in given.to_pylist():
        own.setdefault((row["arm"], row["run"]), []).append(row["cost"])
    for row in found.to_pylist():
        costs = own[row["arm"], row["run"]]
        assert row["cost"] == costs[min(row["trial"], len(costs) - 1)]

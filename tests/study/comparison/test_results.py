"""Tables of trials: rows stay with the study that they are of."""

import numpy as np
import pyarrow as pa
import pytest

from study.comparison.results import by_study
from study.experiment.arms import ARMS


@pytest.mark.parametrize("seed", range(20))
def test_every_row_is_given_to_its_own_study(seed: int) -> None:
    """Arrow's `group_by` gives groups in an order of its own: with it, labels were swapped."""
    rng = np.random.default_rng(seed)
    count = 2000
    arms, runs = rng.choice(list(ARMS), count), rng.integers(0, 50, count)
    columns = {
        "arm": arms.tolist(),
        "run": runs,
        "trial": np.arange(count),
        "cost": rng.random(count),
    }
    given = list(by_study(pa.table(columns)))
    for arm, run, rows in given:
        assert set(rows["arm"].to_pylist()) == {arm} and set(rows["run"].to_pylist()) == {run}
        assert rows["trial"].to_pylist() == np.flatnonzero((arms == arm) & (runs == run)).tolist()
    assert sum(len(rows) for _, _, rows in given) == count
    keys = [(arm, run) for arm, run, _ in given]
    assert keys == sorted(set(keys))


def test_an_empty_table_has_no_studies() -> None:
    empty = pa.table({"arm": pa.array([], pa.string()), "run": pa.array([], pa.int32()),
                      "trial": pa.array([], pa.int32())})  # fmt: skip
    assert list(by_study(empty)) == []

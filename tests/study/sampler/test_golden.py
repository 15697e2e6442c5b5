"""250 proposals, frozen: whoever rewrites the sampler keeps them.

Those by features are of version 0.2.0, those by parameters alone of 0.6.0.
"""

import json
import math
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from study import DoGSampler, FeatureKernelSampler, FeatureTable
from tests.cases import ASSETS

SPACE = {
    "a": FloatDistribution(-1.0, 1.0),
    "b": FloatDistribution(1e-3, 1e1, log=True),
    "c": IntDistribution(1, 9),
    "d": CategoricalDistribution(("x", "y", "z")),
}
FEATURES = ("f0", "f1", "f2")
Proposal = dict[str, Any]
Cost = Callable[[Proposal, int], float]


def cost_of(p, number):
    """A bowl with a shift by choice."""
    shift = {"x": 0.0, "y": 0.3, "z": -0.4}[p["d"]]
    return (
        (p["a"] - 0.3) ** 2
        + 0.1 * math.log(p["b"]) ** 2
        + 0.05 * abs(p["c"] - 4)
        + shift
    )


def extreme(p, number):
    """Cliffs and infinities."""
    if p["a"] > 0.5:
        return math.inf
    return 1e200 if p["c"] > 7 else 1e-9 * cost_of(p, number)


def tied(p, number):
    """Few distinct costs."""
    return float(round(cost_of(p, number)))


def failing(p, number):
    """The fourth and sixth trial end without a value."""
    return math.nan if number in (3, 5) else cost_of(p, number)


def columns(n, seed):
    """Rows of the space."""
    rng = np.random.default_rng(seed)
    return {
        "a": np.round(rng.uniform(-1, 1, n), 6).tolist(),
        "b": np.round(10 ** rng.uniform(-2.9, 0.9, n), 6).tolist(),
        "c": rng.integers(1, 10, n).tolist(),
        "d": [("x", "y", "z")[i] for i in rng.integers(0, 3, n)],
    }


def features_of(points):
    """Features of points [n, 4], the last a choice's index: [n, 3]."""
    a, b, c, d = np.asarray(points, dtype=np.float64).T
    return np.column_stack(
        [(a - 0.2) ** 2 + 0.1 * d, np.log(b) ** 2, np.abs(c - 4) * (1 + a)]
    )


def featured(n, seed):
    """Rows of the space, and their features [n, 3]."""
    rows = columns(n, seed)
    index = [("x", "y", "z").index(d) for d in rows["d"]]
    return rows, features_of(np.column_stack([rows["a"], rows["b"], rows["c"], index]))


def table(n=120, seed=1, *, gaps=False, count=3):
    """Rows with features; some of them unknown or infinite."""
    rows, features = featured(n, seed)
    if gaps:
        features[::7, 0] = np.nan
        features[3::11, 1] = np.inf
        features[5::13, 2] = -np.inf
        features[::20] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return FeatureTable.from_arrays(
            rows, features[:, :count], FEATURES[:count], space=SPACE
        )


def file_table(n=80):
    """A table read from a Parquet file."""
    rows, features = featured(n, 5)
    content = rows | dict(zip(FEATURES, features.T, strict=True))
    path = Path(tempfile.mkdtemp()) / "table.parquet"
    pq.write_table(pa.table(content), path)
    of = {"features": FEATURES, "parameters": tuple(rows), "space": SPACE}
    return FeatureTable.from_parquet(path, **of)


def proposals(
    sampler,
    trials,
    cost=cost_of,
    *,
    limit=None,
    enqueued=(),
    pending=0,
    maximise=False,
):
    """What a sampler proposes in a study, and the row that it noted."""
    study = optuna.create_study(
        sampler=sampler, direction="maximize" if maximise else "minimize"
    )
    for params in enqueued:
        study.enqueue_trial(params)
    waiting = []
    for _ in range(trials):
        trial = study.ask(SPACE)
        params = trial.params
        yield {
            "params": params,
            "row": study.trials[trial.number].user_attrs.get("row"),
        }
        waiting.append((trial, params))
        if len(waiting) > pending:
            told, shown = waiting.pop(0)
            if limit is not None:
                told.set_constraint("limit", limit(shown, told.number))
            value = cost(shown, told.number)
            if math.isnan(value):
                study.tell(told, state=optuna.trial.TrialState.FAIL)
            else:
                study.tell(told, -value if maximise else value)


def limit_of(p, number):
    """A constraint, kept where a <= -0.2."""
    return p["a"] + 0.2


def survival_rows():
    """A table with a ranking, and a feature beside it."""
    rows = columns(70, 3)
    rng = np.random.default_rng(3)
    features = rng.random((70, 2))
    ranking = {"outcomes": features[:, 0], "better": "higher"}
    return FeatureTable.from_arrays(
        rows, features[:, 1], ["speed"], space=SPACE, **ranking
    )


NEAR = {"feature_function": features_of, "off_grid": 50}
ROWS = columns(120, 1)
ENQUEUED = tuple({name: own[row] for name, own in ROWS.items()} for row in (17, 44))
OURS = FeatureKernelSampler
# What proposes, in how many trials of what study.
CASES = {
    "table-additive": (OURS(table(), kernel="additive", seed=1), 14, {}),
    "table-rbf": (OURS(table(), kernel="rbf", seed=1), 14, {}),
    "table-euclidean": (OURS(table(), kernel="euclidean", seed=1), 14, {}),
    "space-baseline": (OURS(space=SPACE, seed=2), 10, {}),
    "space-unknown": (OURS(seed=3), 8, {"maximise": True}),
    "space-additive": (OURS(features_of, space=SPACE, seed=4), 9, {}),
    "off-grid": (OURS(table(60), seed=6, **NEAR), 12, {}),
    "constraints": (OURS(table(), seed=10), 10, {"limit": limit_of}),
    "constraints-space": (OURS(space=SPACE, seed=11), 8, {"limit": limit_of}),
    "enqueued": (OURS(table(), seed=12), 8, {"enqueued": ENQUEUED}),
    "gaps": (OURS(table(gaps=True), seed=13), 12, {}),
    "pending": (OURS(table(), seed=15), 10, {"pending": 2}),
    "pending-space": (OURS(space=SPACE, seed=16), 8, {"pending": 2}),
    "ties": (OURS(table(30), seed=17), 14, {"cost": tied}),
    "extreme": (OURS(table(), seed=19), 10, {"cost": extreme}),
    "failed": (OURS(table(), seed=21), 9, {"cost": failing}),
    "one-feature": (DoGSampler(table(count=1), seed=22), 12, {}),
    "dog": (DoGSampler(table(), seed=23), 8, {}),
    "file": (OURS(file_table(), seed=24), 6, {}),
    "survival": (OURS(survival_rows(), seed=25), 8, {}),
    "large": (OURS(table(6000, 9), seed=26), 6, {}),
    "many-trials": (OURS(table(60), seed=28), 40, {"cost": tied}),
}
GOLDEN = json.loads((ASSETS / "golden-proposals.json").read_text())


def test_every_case_is_frozen():
    assert set(GOLDEN) == set(CASES)


@pytest.mark.parametrize("name", GOLDEN)
@pytest.mark.filterwarnings("ignore")
def test_proposals_are_the_frozen_ones(name):
    sampler, trials, how = CASES[name]
    frozen, made = GOLDEN[name], list(proposals(sampler, trials, **how))
    assert len(frozen) == len(made)
    for number, (was, now) in enumerate(zip(frozen, made, strict=True)):
        assert now["row"] == was["row"], number
        expected = {  # another processor may round otherwise in the last places
            key: pytest.approx(value, rel=1e-9) if isinstance(value, float) else value
            for key, value in was["params"].items()
        }
        assert now["params"] == expected, number

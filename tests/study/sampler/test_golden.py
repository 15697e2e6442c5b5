"""123 proposals, frozen: whoever rewrites the sampler keeps them.

They are of version 0.2.0, but for table-euclidean, space-baseline, space-unknown,
constraints-space, pending-space and survival. These were frozen anew after 0.5.0, on
2026-11-27: the plain process is a Matern 5/2 whose candidates climb, and worlds have an
emulator between rows.
"""

import json
import math
import warnings

import numpy as np
import optuna
import pytest
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from study import FeatureKernelSampler, FeatureTable
from tests.cases import ASSETS

SPACE = {
    "a": FloatDistribution(-1.0, 1.0),
    "b": FloatDistribution(1e-3, 1e1, log=True),
    "c": IntDistribution(1, 9),
    "d": CategoricalDistribution(("x", "y", "z")),
}
FEATURES = ("f0", "f1", "f2")


def cost_of(p):
    """A bowl with a shift by choice."""
    shift = {"x": 0.0, "y": 0.3, "z": -0.4}[p["d"]]
    return (
        (p["a"] - 0.3) ** 2
        + 0.1 * math.log(p["b"]) ** 2
        + 0.05 * abs(p["c"] - 4)
        + shift
    )


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


def table(n=120, seed=1, *, gaps=False):
    """Rows with features; some of them unknown or infinite."""
    rows, features = featured(n, seed)
    if gaps:
        features[::7, 0] = np.nan
        features[3::11, 1] = np.inf
        features[5::13, 2] = -np.inf
        features[::20] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return FeatureTable.from_arrays(rows, features, FEATURES, space=SPACE)


def proposals(
    sampler,
    trials,
    *,
    limited=False,
    pending=0,
    maximise=False,
):
    """What a sampler proposes in a study, and the row that it noted."""
    study = optuna.create_study(
        sampler=sampler, direction="maximize" if maximise else "minimize"
    )
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
            if limited:  # kept where a <= -0.2
                told.set_constraint("limit", shown["a"] + 0.2)
            value = cost_of(shown)
            study.tell(told, -value if maximise else value)


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
OURS = FeatureKernelSampler
# What proposes, in how many trials of what study.
CASES = {
    "table-additive": (OURS(table(), kernel="additive", seed=1), 14, {}),
    "table-euclidean": (OURS(table(), kernel="euclidean", seed=1), 14, {}),
    "space-baseline": (OURS(space=SPACE, seed=2), 10, {}),
    "space-unknown": (OURS(seed=3), 8, {"maximise": True}),
    "space-additive": (OURS(features_of, space=SPACE, seed=4), 9, {}),
    "off-grid": (OURS(table(60), seed=6, **NEAR), 12, {}),
    "constraints": (OURS(table(), seed=10), 10, {"limited": True}),
    "constraints-space": (OURS(space=SPACE, seed=11), 8, {"limited": True}),
    "gaps": (OURS(table(gaps=True), seed=13), 12, {}),
    "pending": (OURS(table(), seed=15), 10, {"pending": 2}),
    "pending-space": (OURS(space=SPACE, seed=16), 8, {"pending": 2}),
    "survival": (OURS(survival_rows(), seed=25), 8, {}),
}
GOLDEN = json.loads((ASSETS / "golden-proposals.json").read_text())


@pytest.mark.parametrize("name", CASES)
@pytest.mark.filterwarnings("ignore")
def test_proposals_are_those_of_0_2_0_or_of_2026_11_27(name):
    sampler, trials, how = CASES[name]
    frozen, made = GOLDEN[name], list(proposals(sampler, trials, **how))
    assert len(frozen) == len(made)
    for number, (was, now) in enumerate(zip(frozen, made, strict=True)):
        assert now["row"] == was["row"], number
        expected = {  # another processor rounds otherwise, and climbers stop elsewhere
            key: pytest.approx(value, rel=1e-6) if isinstance(value, float) else value
            for key, value in was["params"].items()
        }
        assert now["params"] == expected, number

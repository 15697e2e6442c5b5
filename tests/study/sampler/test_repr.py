"""What a table and a sampler look like at a prompt."""

import pickle
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from optuna.distributions import FloatDistribution
from optuna.samplers import RandomSampler

from study import DoGSampler, FeatureKernelSampler, FeatureTable, SurvivalSampler


def table(features: int = 6, parameters: int = 16) -> FeatureTable:
    columns = {f"x{i}": np.linspace(0, 1, 600) for i in range(parameters)}
    names = [chr(ord("a") + i) for i in range(features)]
    return FeatureTable.from_arrays(
        columns, np.random.default_rng(0).random((600, features)), names
    )


def simulate(params: NDArray[np.float64]) -> NDArray[np.float64]:
    return params


@pytest.mark.parametrize(
    ("made", "shown"),
    [
        (lambda: table(), "FeatureTable(600 rows, 16 parameters, 6 features: a, b, c, ...)"),
        (lambda: table(3, 2), "FeatureTable(600 rows, 2 parameters, 3 features: a, b, c)"),
        (
            lambda: FeatureTable.from_arrays({"x": [0.0]}, [[1.0, 2.0]]),
            "FeatureTable(1 row, 1 parameter, 2 features: feature_0, feature_1)",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:FeatureTable")
def test_a_table_shows_its_size_and_features(made, shown: str) -> None:  # type: ignore[no-untyped-def]
    assert repr(made()) == shown


def test_a_table_that_travelled_is_not_read_again_to_be_shown(tmp_path: Path) -> None:
    path = tmp_path / "table.parquet"
    pd.DataFrame({"x": [0.0, 1.0], "f": [1.0, 2.0]}).to_parquet(path)
    made = pickle.dumps(FeatureTable.from_parquet(path, features=["f"], parameters=["x"]))
    path.unlink()
    assert repr(pickle.loads(made)) == "FeatureTable(2 rows, 1 parameter, 1 feature: f)"


TABLE = "FeatureTable(600 rows, 16 parameters, 6 features: a, b, c, ...)"


@pytest.mark.parametrize(
    ("sampler", "shown"),
    [
        (lambda: FeatureKernelSampler(table(), seed=3), f"FeatureKernelSampler({TABLE}, seed=3)"),
        (
            lambda: FeatureKernelSampler(table(), kernel="rbf", off_grid=0, nearest=0.1, seed=3),
            f"FeatureKernelSampler({TABLE}, seed=3, kernel='rbf', nearest=0.1)",
        ),
        (
            lambda: FeatureKernelSampler(
                simulate, seed=3, independent_sampler=RandomSampler(), extra_parameters=["n"]
            ),
            "FeatureKernelSampler(simulate, seed=3, extra_parameters=('n',), "
            "independent_sampler=RandomSampler)",
        ),
        (
            lambda: FeatureKernelSampler(seed=0, space={"x": FloatDistribution(0, 1)}),
            "FeatureKernelSampler(seed=0, space={'x': FloatDistribution("
            "high=1.0, log=False, low=0.0, step=None)})",
        ),
    ],
)
def test_a_sampler_shows_its_seed_and_what_was_chosen(sampler, shown: str) -> None:  # type: ignore[no-untyped-def]
    assert repr(sampler()) == shown


def test_a_seed_that_was_drawn_is_shown() -> None:
    shown = repr(FeatureKernelSampler())
    found = re.fullmatch(r"FeatureKernelSampler\(seed=(\d+)\)", shown)
    assert found and int(found[1]) > 0


def test_presets_go_by_their_own_names() -> None:
    assert repr(DoGSampler(table(), seed=1)).startswith(f"DoGSampler({TABLE}, seed=1")
    survival = table().rows.features
    columns = {"x": np.linspace(0, 1, 600)}
    good = FeatureTable.from_arrays(columns, survival[:, :1], ["survival"])
    assert repr(SurvivalSampler(good, seed=1)).startswith("SurvivalSampler(FeatureTable(600 rows")


def test_a_sampler_that_travelled_shows_the_same() -> None:
    sampler = FeatureKernelSampler(table(), seed=3, kernel="rbf")
    assert repr(pickle.loads(pickle.dumps(sampler))) == repr(sampler)

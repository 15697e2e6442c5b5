"""Optuna's own tests of samplers, on all forms of ours."""

import warnings
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray
from optuna.samplers import BaseSampler
from optuna.testing.pytest_samplers import (
    BasicSamplerTestCase,
    RelativeSamplerTestCase,
    SingleOnlySamplerTestCase,
)

from study import FeatureKernelSampler, FeatureTable

pytestmark = pytest.mark.slow

Factory = Callable[[], BaseSampler]


def one_feature(params: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(params[:, 0])


class Suite(BasicSamplerTestCase, RelativeSamplerTestCase, SingleOnlySamplerTestCase):
    """What Optuna asks of a sampler for one objective."""


@pytest.mark.filterwarnings("ignore:.*the independent sampler takes over")
@pytest.mark.filterwarnings("ignore:trials whose parameters are no row")
class TestTable(Suite):
    """The suite has spaces of its own, with the table's names (x, y) and with others."""

    options: ClassVar[dict[str, Any]] = {}

    @pytest.fixture
    def sampler(self):
        column = np.linspace(0.1, 0.2, 8)
        table = FeatureTable.from_arrays({"x": column, "y": column[::-1]}, column)
        return lambda: FeatureKernelSampler(table, seed=0, strict=False, **self.options)


class TestRankedTable(TestTable):
    """With what the user says of a feature."""

    options: ClassVar[dict[str, Any]] = {"prior": "-feature_0"}


class TestPaper(TestTable):
    """The paper's kernel."""

    options: ClassVar[dict[str, Any]] = {"kernel": "rbf"}


class TestOffGrid(TestTable):
    """Points near the rows as well."""

    options: ClassVar[dict[str, Any]] = {"feature_function": one_feature, "off_grid": 16}


@pytest.mark.filterwarnings("ignore:.*the independent sampler takes over")
@pytest.mark.filterwarnings("ignore:trials whose parameters are no row")
class TestTableOfOtherNames(Suite):
    @pytest.fixture
    def sampler(self):
        table = FeatureTable.from_arrays({"p": [0.0, 0.5, 1.0]}, [1.0, 2.0, 3.0])
        return lambda: FeatureKernelSampler(table, seed=0, strict=False)


def features(params: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([params.sum(axis=1), params.max(axis=1)])


class TestCallable(Suite):
    @pytest.fixture
    def sampler(self):
        return lambda: FeatureKernelSampler(features, seed=0)


class TestPlain(Suite):
    @pytest.fixture
    def sampler(self):
        return lambda: FeatureKernelSampler(seed=0)


def test_the_suite_needs_no_warning_to_be_silenced_without_a_table():
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        FeatureKernelSampler(features), FeatureKernelSampler()
    assert not said

"""Optuna's own tests of samplers, on all three forms."""

import warnings
from collections.abc import Callable

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


class Suite(BasicSamplerTestCase, RelativeSamplerTestCase, SingleOnlySamplerTestCase):
    """What Optuna asks of a sampler for one objective."""


@pytest.mark.filterwarnings("ignore:.*the independent sampler takes over")
@pytest.mark.filterwarnings("ignore:trials whose parameters are no row")
class TestTable(Suite):
    """The suite has spaces of its own, with the table's names (x, y) and with others."""

    @pytest.fixture
    def sampler(self) -> Factory:
        column = np.linspace(0.1, 0.2, 8)
        table = FeatureTable.from_arrays({"x": column, "y": column[::-1]}, column)
        return lambda: FeatureKernelSampler(table, seed=0, strict=False)


@pytest.mark.filterwarnings("ignore:.*the independent sampler takes over")
@pytest.mark.filterwarnings("ignore:trials whose parameters are no row")
class TestTableOfOtherNames(Suite):
    @pytest.fixture
    def sampler(self) -> Factory:
        table = FeatureTable.from_arrays({"p": [0.0, 0.5, 1.0]}, [1.0, 2.0, 3.0])
        return lambda: FeatureKernelSampler(table, seed=0, strict=False)


def features(params: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([params.sum(axis=1), params.max(axis=1)])


class TestCallable(Suite):
    @pytest.fixture
    def sampler(self) -> Factory:
        return lambda: FeatureKernelSampler(features, seed=0)


class TestPlain(Suite):
    @pytest.fixture
    def sampler(self) -> Factory:
        return lambda: FeatureKernelSampler(seed=0)


def test_the_suite_needs_no_warning_to_be_silenced_without_a_table() -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        FeatureKernelSampler(features), FeatureKernelSampler()
    assert not said

"""Optuna's own tests of samplers, on all forms of ours."""

import numpy as np
import pytest
from optuna.testing import pytest_samplers as suite

from study import FeatureKernelSampler, FeatureTable

pytestmark = pytest.mark.slow
LINE = np.linspace(0.1, 0.2, 8)
TABLE = FeatureTable.from_arrays({"x": LINE, "y": LINE[::-1]}, LINE)
WORLDS = np.column_stack([(LINE - 0.12) ** 2, (LINE - 0.17) ** 2])
OTHER = FeatureTable.from_arrays({"p": [0.0, 0.5, 1.0]}, [1.0, 2.0, 3.0])


def two_features(params):
    return np.column_stack([params.sum(axis=1), params.max(axis=1)])


NEAR = {"feature_function": lambda params: params[:, 0], "off_grid": 16}
# The suite has spaces of its own, with the table's names (x, y) and with others.
FORMS = {
    "table": {"features": TABLE, "strict": False},
    "paper": {"features": TABLE, "strict": False, "kernel": "rbf"},
    "worlds": {
        "features": FeatureTable.from_arrays(
            {"x": LINE, "y": LINE[::-1]}, outcomes=WORLDS
        ),
        "strict": False,
    },
    "off grid": {"features": TABLE, "strict": False, **NEAR},
    "table of other names": {"features": OTHER, "strict": False},
    "callable": {"features": two_features},
    "plain": {},
}


@pytest.mark.filterwarnings("ignore:.*the independent sampler takes over")
@pytest.mark.filterwarnings("ignore:trials whose parameters are no row")
class TestSampler(
    suite.BasicSamplerTestCase,
    suite.RelativeSamplerTestCase,
    suite.MultiObjectiveSamplerTestCase,
):
    """What Optuna asks of a sampler for one objective and for several."""

    @pytest.fixture(params=FORMS)
    def sampler(self, request):
        return lambda: FeatureKernelSampler(seed=0, **FORMS[request.param])

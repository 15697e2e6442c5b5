"""One made-up comparison for the tests of the report."""

import pytest

from study.report.runs import read_results
from tests.study.report import synthetic


@pytest.fixture(scope="session")
def comparison(tmp_path_factory):
    """Fourteen arms, 50 runs, 100 trials."""
    return synthetic.write(tmp_path_factory.mktemp("report") / "made-up")


@pytest.fixture(scope="session")
def results(comparison):
    return read_results(comparison)

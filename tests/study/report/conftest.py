"""One made-up comparison for the tests of the report."""

from pathlib import Path

import pytest

from study.report.runs import Results, read_results
from tests.study.report import synthetic


@pytest.fixture(scope="session")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fourteen arms, 50 runs, 100 trials."""
    return synthetic.write(tmp_path_factory.mktemp("report") / "made-up")


@pytest.fixture(scope="session")
def results(comparison: Path) -> Results:
    return read_results(comparison)

"""The timing command on small tables: what it measures, writes and refuses."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.tools.running import load_tool

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
TOOL = load_tool("time_sampler")
SMALL = ("--rows", "2000", "--observations", "12", "--repeats", "3", "--sweep", "5,30")


def time_sampler(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "tools/time_sampler.py", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    done = time_sampler(*SMALL, "--large-rows", "50000", "--json")
    assert done.returncode == 0, done.stderr
    parsed: dict[str, Any] = json.loads(done.stdout)
    return parsed


def test_every_case_is_measured(report: dict[str, Any]) -> None:
    cases = [(row["case"]["sampler"], row["case"]["features"]) for row in report["proposals"]]
    assert cases == [("ours", 1), ("ours", 5), ("rbf", 1)]
    assert [row["case"]["observations"] for row in report["sweep"]] == [5, 30]
    assert (report["best"]["case"]["sampler"], report["best"]["case"]["features"]) == ("best", 6)
    for row in [*report["proposals"], report["best"], *report["sweep"]]:
        assert len(row["seconds"]) == 3
        assert 0.1 < row["median_ms"] < 10_000
        assert row["median_ms"] == pytest.approx(1e3 * sorted(row["seconds"])[1])
        assert 0.1 < row["median_cpu_ms"] < 10_000


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read on Linux only")
def test_memory_grows_at_least_by_the_table(report: dict[str, Any]) -> None:
    table_mib = 50_000 * (16 + 5) * 8 / 2**20
    large = report["large"]
    assert large["case"]["rows"] == 50_000
    assert table_mib < large["peak_grown_mib"] < 1000


def test_a_proposal_is_made_in_a_study_of_the_observations_asked_for() -> None:
    measured = TOOL.measure_case(TOOL.Case("ours", rows=300, features=2, observations=9, repeats=2))
    assert len(measured.seconds) == 2
    assert measured.median_ms > 0.0


def fake(features: int, ms: float, sampler: str = "ours", observations: int = 100) -> Any:
    case = TOOL.Case(sampler, 100_000, features, observations, 1)
    return TOOL.Measured(case, (ms / 1e3,), (ms / 2e3,), 50.0, 150.0)


def document(tmp_path: Path, peer: Any) -> str:
    proposals = [fake(1, 30.0), fake(5, 70.0), fake(1, 5.0, "rbf")]
    sweep = [fake(1, 8.0, observations=10), fake(1, 900.0, observations=1000)]
    timings = TOOL.Timings(proposals, fake(6, 18.0), peer, sweep, fake(5, 400.0))
    options = type("Options", (), {"repeats": 1, "observations": 100, "rows": 100_000})
    TOOL.plot(timings, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 5_000
    return str(TOOL.markdown(timings, options))


def test_the_document_says_which_bars_hold(tmp_path: Path) -> None:
    text = document(tmp_path, fake(0, 120.0))
    row = "| 1 feature | 30 ms | 30 to 30 ms | 15 ms |"
    assert f"{row} at most 10 ms: **missed** |" in text
    assert "at most 45 ms: holds" in text
    row = "| 1 feature, the paper's kernel | 5 ms | 5 to 5 ms | 2 ms |"
    assert f"{row} at most 10 ms: holds |" in text
    assert "| `SurvivalSampler`, a tenth of the rows are candidates | 18 ms | 18 to 18 ms |" in text
    assert "| 1,000 | 900 ms | 450 ms | at most 1000 ms: holds |" in text
    assert "at least 5 x ours: 4.0 x, **missed**" in text
    assert "at most 191 MiB: holds" in text


def test_the_document_says_that_gpsampler_was_not_measured(tmp_path: Path) -> None:
    assert "| GPSampler | not measured: no PyTorch | | | |" in document(tmp_path, None)

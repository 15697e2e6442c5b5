"""The timing command on small tables: what it measures and writes."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.tools.running import ROOT, load_tool

pytestmark = pytest.mark.slow

TOOL = load_tool("time_sampler")
SMALL = ("--rows", "2000", "--observations", "12", "--repeats", "3", "--sweep", "5,30")


def test_every_case_is_measured() -> None:
    command = [sys.executable, "tools/time_sampler.py", *SMALL, "--large-rows", "50000", "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    cases = [(each["case"]["sampler"], each["case"]["features"]) for each in report["cases"]]
    foreign = [("foreign", 1)] * 2
    assert cases == [("ours", 1), ("ours", 5), *foreign, ("rbf", 1), ("best", 6),
                     *[("ours", 1)] * 2, ("ours", 5)]  # fmt: skip
    *usual, large = report["cases"]
    assert [each["case"]["observations"] for each in usual] == [12] * 3 + [30] + [12] * 2 + [5, 30]
    for each in usual:
        assert 0.1 < each["fastest_ms"] <= each["median_ms"] <= each["slowest_ms"] < 10_000
        assert 0.1 < each["median_cpu_ms"] < 10_000 and 0.1 < each["first_cpu_ms"] < 10_000
    assert large["case"]["rows"] == 50_000
    if Path("/proc/self/status").exists():  # memory is read on Linux only
        table_mib = 50_000 * (16 + 5) * 8 / 2**20
        assert table_mib < large["peak_mib"] < 1000


def fake(ms: float, sampler: str = "ours", observations: int = 100, **bars: float) -> Any:
    case = TOOL.Case(sampler, 100_000, 1, observations, 1, tuple(bars.items()))
    return TOOL.Measured(case, ms, ms - 1, ms + 1, ms / 2, 3 * ms, 50.0, 150.0)


OVER = "| GPSampler's median over ours |"
SAID = {120.0: f"{OVER} 4.0, at least 5 | **no** |", 150.0: f"{OVER} 5.0, at least 5 | yes |",
        None: "GPSampler was not measured: no PyTorch."}  # fmt: skip


@pytest.mark.parametrize(("gp_ms", "said"), SAID.items())
def test_the_document_says_which_bars_hold(gp_ms: float | None, said: str, tmp_path: Path) -> None:
    timings = TOOL.Timings([
        fake(30.0, median_cpu_ms=10.0), fake(70.0, median_cpu_ms=45.0, peak_mib=149.0),
        fake(5.0, "rbf"), fake(18.0, "best"), fake(900.0, observations=1000, median_ms=1000.0),
        *([fake(gp_ms, "gp")] if gp_ms else []),
    ])  # fmt: skip
    text = timings.markdown()
    rows = [
        "| ours | 100,000 | 1 | 100 | 1 | 30 | 29 | 31 | 15 | 90 | 50 | 150 |",
        "| ours, the paper's kernel | 100,000 | 1 | 100 | 1 | 5 | 4 | 6 | 2 | 15 |",
        "| `SurvivalSampler`, a tenth of the rows are candidates | 100,000 | 1 | 100 | 1 | 18 |",
        "100 trials: median cpu ms | 15, at most 10 | **no** |",
        "100 trials: median cpu ms | 35, at most 45 | yes |",
        "100 trials: peak mib | 150, at most 149 | **no** |",
        "1,000 trials: median ms | 900, at most 1000 | yes |", said,
    ]  # fmt: skip
    assert [row for row in rows if row not in text] == []
    timings.plot(tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 5_000

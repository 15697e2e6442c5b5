"""The timing of a proposal on small tables: what it measures and writes."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.tools.running import ROOT, load_tool

pytestmark = pytest.mark.slow

TOOL = load_tool("time_sampler")


def test_every_case_is_measured(tmp_path: Path) -> None:
    words = ("--rows", "5000", "--repeats", "3", "--out", str(tmp_path))
    command = [sys.executable, "tools/time_sampler.py", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "sampler-timing.md").read_text()
    rows = [line.replace(",", "").split(" | ") for line in text.splitlines() if "---" not in line]
    _, *rows = [row[1:] for row in rows if len(row) == 12]  # the first is the heading
    numbers = [[float(cell.strip(" |")) for cell in row] for row in rows]
    usual = [(1, 100), (5, 100), (1, 100), (1, 1000), (1, 100), (6, 100), (1, 10), (1, 30),
             (1, 300), (1, 1000)]  # fmt: skip
    sizes = [(5000, *case, 3) for case in usual] + [(50_000, 5, 100, 3)]
    assert [tuple(row[:4]) for row in numbers[:11]] == sizes  # then GPSampler, where it is
    if Path("/proc/self/status").exists():  # memory is read on Linux only
        assert 50_000 * (16 + 5) * 8 / 2**20 < numbers[10][-1] < 1000
    assert (tmp_path / "sampler-timing.png").stat().st_size > 5_000


def test_times_are_in_order() -> None:
    each = TOOL.measure_case(TOOL.Case("ours", 2000, 1, 12, 3))
    assert 0.1 < each.fastest_ms <= each.median_ms <= each.slowest_ms < 10_000
    assert 0.1 < each.median_cpu_ms < 10_000 and 0.1 < each.first_cpu_ms < 10_000


def fake(ms: float, sampler: str = "ours", observations: int = 100, **bars: float) -> Any:
    case = TOOL.Case(sampler, 100_000, 1, observations, 1, tuple(bars.items()))
    return TOOL.Measured(case, ms, ms - 1, ms + 1, ms / 2, 3 * ms, 50.0, 150.0)


OVER = "| GPSampler's median over ours |"
SAID = {120.0: f"{OVER} 4.0, at least 5 | **no** |", 150.0: f"{OVER} 5.0, at least 5 | yes |",
        None: "GPSampler was not measured: no PyTorch."}  # fmt: skip


@pytest.mark.parametrize(("gp_ms", "said"), SAID.items())
def test_the_page_says_which_bars_hold(gp_ms: float | None, said: str) -> None:
    text = "\n".join(TOOL.figures([
        fake(30.0, median_cpu_ms=10.0), fake(70.0, median_cpu_ms=45.0, peak_mib=149.0),
        fake(5.0, "rbf"), fake(18.0, "best"), fake(900.0, observations=1000, median_ms=1000.0),
        *([fake(gp_ms, "gp")] if gp_ms else []),
    ]))  # fmt: skip
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

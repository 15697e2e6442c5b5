"""The benchmark command on a few walkers: what it reports, and what it refuses."""

import os
import re
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import pytest

from taichi_nmm.errors import InputError
from tests.tools.running import ROOT, load_tool

pytestmark = pytest.mark.slow

SAMPLES = 64


@pytest.mark.campaign
def test_start_and_run_are_timed_apart_and_compared_with_others() -> None:
    words = ("--samples", str(SAMPLES), "--arch", "cpu", "--threads", "--mujoco")
    command = [sys.executable, "tools/bench.py", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

    def numbers(start: str) -> list[float]:
        (line,) = re.findall(rf"^{start} .*", done.stdout, re.MULTILINE)
        return [float(word) for word in re.findall(r"[\d.]+\d|\d", line.replace(",", ""))]

    assert numbers("cold start")[0] > numbers("warm start")[0] > 0.0
    samples, duration_s, run_s, alive = numbers("run")
    assert (samples, duration_s) == (SAMPLES, 5.0) and run_s < numbers("cold start")[0]
    assert 0 < alive < 100
    walkers_per_s, steps_per_s = numbers("speed")
    assert 1000 * 5 * alive / 100 <= steps_per_s / walkers_per_s * 1.01 <= 1.02 * 1000 * 5
    assert 50 < numbers("peak memory")[0] < 4096
    threads = [numbers(f"{count:7}") for count in sorted({1, os.cpu_count() or 1})]
    assert all(seconds > 0.0 for _, seconds, _ in threads) and threads[0][2] == 1.0
    (_, single, ratio) = numbers("1 thread")
    assert single > 1000 and ratio == pytest.approx(steps_per_s / single, rel=0.01)


RUN = {
    "arch": "x64", "precision": "float32", "lanes": 8, "start_s": 12.0, "run_s": 2.0, "alive": 16,
    "steps": 80_000.0, "peak_rss_mib": 612.3,
}  # fmt: skip
MUJOCO = {"version": "3", "threads": 2, "steps_per_s_single": 1e4, "steps_per_s_all": 2e4}


def test_the_report_is_readable(monkeypatch: pytest.MonkeyPatch) -> None:
    def measured(what: str, *_: object) -> dict[str, object]:
        return MUJOCO if what == "MuJoCo" else RUN | {"run_s": 3.0 if what == "1 threads" else 2.0}

    tool = load_tool("bench")
    monkeypatch.setattr(tool, "run_json", measured)
    monkeypatch.setattr(tool.os, "cpu_count", lambda: 2)
    options = Namespace(samples=64, lanes=[8], threads=True, mujoco=True, arch="cpu")
    said = "\n".join(tool.measure(options, Path("nowhere")))
    for line in (
        "cold start     12.0 s (compiles)", "64 points x 5 s in 2.0 s, 25.0 % alive at the end",
        "peak memory    612 MiB", "0.07 x the speed of scalar C, float64", "    8          12.0",
        "      2      2.00    1.50 x", "2 threads      20,000 steps/s; ours 2.0 x",
    ):  # fmt: skip
        assert line in said


def test_checkouts_are_compared_by_median_turns_and_lane_widths_are_a_list() -> None:
    line = load_tool("bench").turns_line("steady", [100.0, 300.0, 120.0], [200.0, 400.0, 240.0])
    assert line.split() == ["steady", "120.0", "240.0", "0.500"]
    lane_widths = load_tool("bench").lane_widths
    assert (lane_widths(""), lane_widths("1,4,16")) == ([], [1, 4, 16])
    for wrong in ("0", "4,,8", "1,four", "1.5"):
        with pytest.raises(InputError, match="lanes"):
            lane_widths(wrong)

"""The benchmark command on a few walkers: what it reports, and what it refuses."""

import json
import os
import subprocess
import sys

import pytest

from taichi_nmm.errors import InputError
from tests.tools.running import ROOT, load_tool

pytestmark = pytest.mark.slow

SAMPLES = 64


@pytest.mark.campaign
def test_start_and_run_are_timed_apart_and_compared_with_others() -> None:
    words = ("--samples", str(SAMPLES), "--arch", "cpu", "--threads", "--mujoco", "--json")
    command = [sys.executable, "tools/bench.py", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    run, ratios, mujoco = report["run"], report["times_reference_speed"], report["mujoco"]
    assert report["cold_start_s"] > report["warm_start_s"] > 0.0
    assert run["run_s"] < report["cold_start_s"]
    assert run["samples"] == SAMPLES > run["alive"] > 0
    assert run["walkers_per_s"] * run["run_s"] == pytest.approx(SAMPLES)
    steps = run["walker_steps_per_s"] * run["run_s"]
    assert 1000 * 5 * run["alive"] <= steps <= 1000 * 5 * SAMPLES
    assert 50 < run["peak_rss_mib"] < 4096
    per_s = run["walkers_per_s"]
    assert ratios["scalar C, float64"] == pytest.approx(per_s / (100_000 / 234.0))
    assert ratios["hand-written AVX-512, float32"] == pytest.approx(per_s / (100_000 / 14.9))
    threads = {row["threads"]: row["run_s"] for row in report["threads"]}
    assert list(threads) == sorted({1, os.cpu_count() or 1}) and min(threads.values()) > 0.0
    assert mujoco["steps_per_s_single"] > 1000
    for name in ("single", "all"):
        ratio = run["walker_steps_per_s"] / mujoco[f"steps_per_s_{name}"]
        assert mujoco[f"ratio_to_{name}"] == pytest.approx(ratio)


def test_the_report_is_readable() -> None:
    run = {
        "arch": "x64", "precision": "float32", "lanes": 8, "samples": 64, "duration_s": 5.0,
        "run_s": 2.0, "alive": 16, "walkers_per_s": 32.0, "walker_steps_per_s": 40_000.0,
        "peak_rss_mib": 612.3,
    }  # fmt: skip
    said = load_tool("bench").text({
        "machine": {"cores": 2, "system": "Linux x86_64"}, "cold_start_s": 20.0,
        "warm_start_s": 2.0, "run": run, "times_reference_speed": {"scalar C, float64": 0.5},
        "lanes": [run | {"start_s": 12.0}],
        "threads": [{"threads": 1, "run_s": 3.0}, {"threads": 2, "run_s": 2.0}],
        "mujoco": {"version": "3", "threads": 2, "steps_per_s_single": 1e4, "steps_per_s_all": 2e4,
                   "ratio_to_single": 4.0, "ratio_to_all": 2.0},
    })  # fmt: skip
    for line in (
        "cold start     20.0 s (compiles)", "64 points x 5 s in 2.0 s, 25.0 % alive at the end",
        "peak memory    612 MiB", "0.50 x the speed of scalar C, float64", "    8          12.0",
        "      2      2.00    1.50 x", "2 threads      20,000 steps/s; ours 2.0 x",
    ):  # fmt: skip
        assert line in said


def test_checkouts_are_compared_by_median_turns_and_lane_widths_are_a_list() -> None:
    turns = {"steady": {"this": [100.0, 300.0, 120.0], "other": [200.0, 400.0, 240.0]}}
    row = load_tool("bench").turns_text(turns).splitlines()[1]
    assert row.split() == ["steady", "120.0", "240.0", "0.500"]
    lane_widths = load_tool("bench").lane_widths
    assert (lane_widths(""), lane_widths("1,4,16")) == ([], [1, 4, 16])
    for wrong in ("0", "4,,8", "1,four", "1.5"):
        with pytest.raises(InputError, match="lanes"):
            lane_widths(wrong)

"""The benchmark command on a few walkers: what it reports, and what it refuses."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from taichi_nmm.errors import InputError
from tests.tools.running import load_tool

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = 64


def bench(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "tools/bench.py", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    done = bench("--samples", str(SAMPLES), "--arch", "cpu", "--threads", "--mujoco", "--json")
    assert done.returncode == 0, done.stderr
    parsed: dict[str, Any] = json.loads(done.stdout)
    return parsed


@pytest.mark.campaign
def test_compilation_is_timed_apart_from_the_run(report: dict[str, Any]) -> None:
    assert report["cold_start_s"] > report["warm_start_s"] > 0.0
    assert report["run"]["run_s"] < report["cold_start_s"]


@pytest.mark.campaign
def test_speed_is_that_of_the_walkers_simulated(report: dict[str, Any]) -> None:
    run = report["run"]
    assert run["samples"] == SAMPLES
    assert run["walkers_per_s"] * run["run_s"] == pytest.approx(SAMPLES)
    steps = run["walker_steps_per_s"] * run["run_s"]
    assert 1000 * 5 * run["alive"] <= steps <= 1000 * 5 * SAMPLES
    assert 0 < run["alive"] < SAMPLES


@pytest.mark.campaign
def test_memory_is_that_of_the_run(report: dict[str, Any]) -> None:
    assert 50 < report["run"]["peak_rss_mib"] < 4096


@pytest.mark.campaign
def test_ratios_compare_with_the_references(report: dict[str, Any]) -> None:
    ratios = report["times_reference_speed"]
    per_s = report["run"]["walkers_per_s"]
    assert ratios["scalar C, float64"] == pytest.approx(per_s / (100_000 / 234.0))
    assert ratios["hand-written AVX-512, float32"] == pytest.approx(per_s / (100_000 / 14.9))


@pytest.mark.campaign
def test_few_walkers_are_timed_on_one_thread_and_on_all(report: dict[str, Any]) -> None:
    threads = [row["threads"] for row in report["threads"]]
    assert threads == sorted({1, os.cpu_count() or 1})
    assert all(row["run_s"] > 0.0 for row in report["threads"])


@pytest.mark.campaign
def test_mujoco_steps_are_counted_in_the_same_run(report: dict[str, Any]) -> None:
    mujoco = report["mujoco"]
    ours = report["run"]["walker_steps_per_s"]
    assert mujoco["steps_per_s_single"] > 1000
    assert mujoco["ratio_to_all"] == pytest.approx(ours / mujoco["steps_per_s_all"])


def test_two_checkouts_are_compared_by_their_median_turns() -> None:
    turns_text = load_tool("bench").turns_text
    turns = {"steady": {"this": [100.0, 300.0, 120.0], "other": [200.0, 400.0, 240.0]}}
    assert turns_text(turns).splitlines()[1].split() == ["steady", "120.0", "240.0", "0.500"]


def test_lane_widths_are_read_from_a_list() -> None:
    lane_widths = load_tool("bench").lane_widths
    assert lane_widths("") == []
    assert lane_widths("1,4,16") == [1, 4, 16]
    for wrong in ("0", "4,,8", "1,four", "1.5"):
        with pytest.raises(InputError, match="lanes"):
            lane_widths(wrong)

"""Whole numbers on the command line: the bounds of configurations, and one line beyond them."""

from pathlib import Path

import pytest

from tests.tools.running import run_tool

CONFIG = ("--config", "rough8-smooth")
STUDY = (*CONFIG, "--arm", "random", "--storage", "sqlite:///new.db")
OPTIMUM = ("--config", "optimum-smooth")
HUGE = 10**9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tool", "options", "says"),
    [
        ("compare", (*CONFIG, "--runs", HUGE), f"runs: {HUGE} cannot be used; allowed: a whole"),
        ("compare", (*CONFIG, "--trials", HUGE), f"trials: {HUGE}"),
        ("compare", (*CONFIG, "--workers", HUGE), f"workers: {HUGE}"),
        ("compare", (*CONFIG, "--seed", 2**63), f"seed: {2**63}"),
        ("compare", (*CONFIG, "--runs", "9" * 5000), "runs: '999"),
        ("compare", (*CONFIG, "--runs", "1.5"), "runs: '1.5' cannot be used; allowed: a whole"),
        ("compare", (*CONFIG, "--rums", 1), "unrecognized arguments: --rums 1"),
        ("compare", (), "the following arguments are required: --config"),
        ("optimum", (*OPTIMUM, "--runs", 10**6), f"runs: {10**6}"),
        ("optimum", (*OPTIMUM, "--max-generations", HUGE), f"max-generations: {HUGE}"),
        ("precompute", ("--samples", 2**40), f"samples: {2**40}"),
        ("precompute", ("--workers", 0), "workers: 0"),
        ("study", (*STUDY, "--trials", HUGE), f"trials: {HUGE}"),
        ("study", (*STUDY, "--seed", -1), "seed: -1"),
        ("study", (*STUDY, "--run", HUGE), f"run: {HUGE}"),
        ("validate", ("--samples", 2**40), f"samples: {2**40}"),
        ("validate", ("--samples", 99), "samples: 99 cannot be used; allowed: a whole number from"),
        ("validate", ("--draws", HUGE), f"draws: {HUGE}"),
        ("validate", ("--seed", -1), "seed: -1"),
        ("validate_mujoco", ("--samples", 2**40), f"samples: {2**40}"),
        ("walk", ("--seed", -1), "seed: -1"),
        ("bench", ("--samples", 2**40), f"samples: {2**40}"),
        ("time_sampler", ("--rows", 2**40), f"rows: {2**40}"),
        ("time_sampler", ("--sweep", f"10,{HUGE}"), "sweep: "),
        ("compare_peers", ("--seeds", HUGE), f"seeds: {HUGE}"),
        ("compare_outside", ("--trials", HUGE), f"trials: {HUGE}"),
        ("bench", ("--samples", 0), "samples: 0"),
        ("bench", ("--lanes", "1,65"), "lanes: '1,65'"),
        ("bench", ("--against", "."), "against: "),
        ("time_sampler", ("--sweep", "10,x"), "sweep: '10,x'"),
        ("time_sampler", ("--sweep", "0,10"), "sweep: '0,10'"),
        ("time_sampler", ("--repeats", 0), "repeats: 0"),
        ("time_sampler", ("--rows", 500), "rows: 500 cannot be used; allowed: more than 1011"),
        *(
            (tool, (flag, value), f"{flag[2:]}: {value!r} cannot".replace("random,best", "best"))
            for tool in ("compare_peers", "compare_outside")
            for flag, value in (
                ("--arms", "random,best"),
                ("--problems", "easy"),
                ("--trials", 1),
                ("--seeds", 0),
            )
        ),
    ],
)
def test_a_number_out_of_bounds_is_one_line(
    tool: str,
    options: tuple[object, ...],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_tool(monkeypatch, tool, *options) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith(f"error: {says}") and said.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []

"""Every tool explains itself; what the tools for speed measure and print; what one counts."""

import json
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import optuna
import pytest

from study import FeatureKernelSampler, FeatureTable
from study.commands.validate import Figure, show
from study.options import COMMANDS, documentation, parser_of
from tests.processes import printed
from tests.tools.running import ROOT, TOOLS, load_tool

MOST_FILES, MOST_CLASSES = 12, 11  # of a proposal; 34 and 26 in 0.2.0


@pytest.mark.slow
@pytest.mark.parametrize("tool", TOOLS)
def test_a_tool_explains_itself(tool, monkeypatch, capsys):
    file = ROOT / "tools" / f"{tool}.py"
    monkeypatch.setattr(sys, "argv", [str(file), "--help"])
    monkeypatch.setattr(sys, "path", [str(file.parent), *sys.path])
    with pytest.raises(SystemExit, check=lambda end: not end.code):
        runpy.run_path(str(file), run_name="__main__")
    text = parser_of(tool).description if tool in COMMANDS else documentation(file)
    assert text and text in capsys.readouterr().out


def test_a_proposal_passes_few_files_and_classes():
    """It is followed on a few screens."""
    rng, called = np.random.default_rng(1), set()
    columns = dict(zip("abcd", rng.random((4, 200)), strict=True))
    table = FeatureTable.from_arrays(columns, rng.random((200, 3)))
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))

    def count(frame, event, argument):
        file = Path(frame.f_code.co_filename)
        if event == "call" and file.is_relative_to(ROOT) and ".venv" not in file.parts:
            called.add((file, frame.f_code.co_qualname.partition(".<locals>")[0]))

    def objective(trial):
        return sum(
            trial.suggest_float(name, x.min(), x.max()) for name, x in columns.items()
        )

    study.optimize(objective, n_trials=10)
    called.clear()
    sys.setprofile(count)
    try:
        objective(study.ask())
    finally:
        sys.setprofile(None)
    files = {file for file, _ in called if "tests" not in file.parts}
    classes = {name.rpartition(".")[0] for file, name in called if file in files} - {""}
    assert "FeatureKernelSampler" in classes
    assert len(files) <= MOST_FILES, files
    assert len(classes) <= MOST_CLASSES, classes


# As of validate.
FIGURES = (
    Figure("speed", np.float64(1.4), 1.365, 1.425, "m/s"),
    Figure("tick", 250.0, 0, 200, "us"),
    Figure("steps a second", 50_000.0, low=45_000),
    Figure("alive", 10.1, unit="%"),
)


def test_figures_are_a_table_or_one_list(capsys):
    show(iter(FIGURES), "20 points", as_json=False)
    head, _, *table = capsys.readouterr().out.splitlines()
    assert head.startswith("20 points; 20") and "Python 3." in head
    assert table == [
        "| what | measured | bar | holds |",
        "|---|---|---|---|",
        "| speed | 1.4 m/s | 1.365 to 1.425 | yes |",
        "| tick | 250 us | 0 to 200 | **no** |",
        "| steps a second | 5e+04  | 45000 | yes |",
        "| alive | 10.1 % | | |",
    ]
    show(iter(FIGURES), "20 points", as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert [each["what"] for each in found] == [figure.what for figure in FIGURES]
    assert [each["holds"] for each in found] == [True, False, True, True]
    assert found[3]["low"] is None


# tools/time_walks.py on a few walkers.
SAMPLES = 64


@pytest.mark.campaign
def test_start_and_run_are_timed_apart():
    said = printed("tools/time_walks.py", "--samples", SAMPLES, "--arch", "cpu")

    def numbers(start):
        (line,) = re.findall(rf"^{start} .*", said, re.MULTILINE)
        return [
            float(word) for word in re.findall(r"[\d.]+\d|\d", line.replace(",", ""))
        ]

    assert numbers("cold start")[0] > numbers("warm start")[0] > 0.0
    samples, duration_s, run_s, alive = numbers("run")
    assert (samples, duration_s) == (SAMPLES, 5.0) and run_s < numbers("cold start")[0]
    assert 0 < alive < 100
    walkers_per_s, steps_per_s = numbers("speed")
    assert (
        1000 * 5 * alive / 100 <= steps_per_s / walkers_per_s * 1.01 <= 1.02 * 1000 * 5
    )
    assert 50 < numbers("peak memory")[0] < 4096


def test_checkouts_are_compared_by_median_turns():
    ours, theirs = [100.0, 300.0, 120.0], [200.0, 400.0, 240.0]
    line = load_tool("time_walks").turns_line("steady", ours, theirs)
    assert line.split() == ["steady", "120.0", "240.0", "0.500"]


# tools/time_sampler.py on small tables.
TIMES = load_tool("time_sampler")


@pytest.mark.slow
def test_every_case_is_measured():
    _, _, *rows = printed("tools/time_sampler.py", "--rows", 5000).splitlines()
    for row, case in zip(rows, TIMES.cases(5000), strict=True):
        sizes = f"{case.rows:,} | {case.features} | {case.observations:,}"
        assert row.startswith(f"| {TIMES.LABELS[case.sampler]} | {sizes} | ")
    _, *numbers, _ = rows[-1].split(" | ")
    proposal_ms, _, first_ms, _, peak_mib = [
        float(number.strip("*")) if number != "-" else None for number in numbers[3:]
    ]
    assert 0.1 < proposal_ms < first_ms < 10_000
    assert 50_000 * (16 + 5) * 8 / 2**20 < peak_mib < 1000


def test_a_number_above_its_bar_is_bold():
    case = TIMES.Case("rbf", 100_000, 1, 100, bars=(10.0, 45.0, TIMES.NO_BAR))
    assert TIMES.row(case, TIMES.Measured(10.2, 45.0, 5000.0)) == (
        "| ours, the paper's kernel | 100,000 | 1 | 100 | **10** | 10 | 45 | 45 | 5,000 | - |"
    )

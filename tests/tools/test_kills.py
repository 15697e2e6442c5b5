"""Killed commands, resumed, leave what a whole run leaves; and what differs is found."""

import re
import subprocess
import sys
from pathlib import Path

import optuna
import pytest
from optuna.trial import TrialState
from optuna_dashboard import save_note

from tests.tools import kills
from tests.tools.running import ROOT

KILLS = 12


@pytest.mark.campaign
def test_all_commands_resume_bit_equal_after_two_kills_each() -> None:
    """In a process of its own, since it forks."""
    pytest.importorskip("ribs")
    words = [sys.executable, "-m", kills.__name__, "--kills", str(KILLS)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = re.findall(r"\| ([\w-]+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|", done.stdout)
    assert [row[0] for row in rows] == [*kills.SCENES]
    assert sum(int(row[1]) for row in rows) >= KILLS
    assert all(int(row[3]) > 0 and row[3] == row[4] for row in rows)


FORGETFUL = """
import os
from study.commands import draw_store
from tests.tools import kills
draw = draw_store.draw_store
draw_store.draw_store = lambda store: (made := draw(store)).suptitle(str(os.getpid())) and made
kills.main()
"""


@pytest.mark.campaign
def test_a_command_whose_picture_differs_at_every_run_is_found() -> None:
    words = [sys.executable, "-c", FORGETFUL, "--kills", "2", "--commands", "draw-store"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "draw-store: store.png" in done.stderr.splitlines()[-1]


def study_of(folder: Path, cut_short: int, note: str) -> dict[str, str]:
    """The digest of a folder with one study; its finished trial comes after those cut short."""
    folder.mkdir()
    study = optuna.create_study(storage=f"sqlite:///{folder / 'studies.db'}", study_name="s")
    for _ in range(cut_short):
        study.tell(study.ask(), state=TrialState.FAIL)
    trial = study.ask()
    trial.suggest_float("x", 1.0, 1.0)
    study.tell(trial, 2.0)
    save_note(trial, note)
    return kills.digest(folder)


def test_a_trials_note_is_the_same_however_many_were_cut_short_before_it(tmp_path: Path) -> None:
    whole = study_of(tmp_path / "whole", 0, "walked")
    assert study_of(tmp_path / "killed", 2, "walked") == whole
    assert study_of(tmp_path / "other", 0, "fell") != whole

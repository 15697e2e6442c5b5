"""What two runs of a command need not agree upon, and what they must."""

from pathlib import Path

import optuna
from optuna.trial import TrialState
from optuna_dashboard import save_note

from tools.killing.digest import digest


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
    return digest(folder)


def test_a_trials_note_is_the_same_however_many_were_cut_short_before_it(tmp_path: Path) -> None:
    whole = study_of(tmp_path / "whole", 0, "walked")
    assert study_of(tmp_path / "killed", 2, "walked") == whole
    assert study_of(tmp_path / "other", 0, "fell") != whole

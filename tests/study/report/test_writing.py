"""A report is written whole or not at all."""

from pathlib import Path

import numpy as np
import pytest

from storage.commit import together
from study.report import figures
from study.report.figures import write_report
from study.report.runs import Results
from taichi_nmm.errors import InputError
from tests.study.report.synthetic import arm, counted


def test_a_single_arm_of_a_single_run_is_reported(tmp_path: Path) -> None:
    write_report(counted(arm("random", [np.inf], trials=2)), folder=tmp_path)
    assert "| 1 | 0 | 0 to 79 | > 2 |" in (tmp_path / "report.md").read_text()


def test_a_failed_report_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(path: Path, results: Results) -> None:
        path.touch()
        raise InputError("disk", "full", "space")

    monkeypatch.setattr(figures, "write_best_cost", fails)
    (tmp_path / "report.md").write_text("an older one")
    with pytest.raises(InputError, match="disk"):
        write_report(counted(arm("random", [np.inf], trials=2)), folder=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["report.md"]
    assert (tmp_path / "report.md").read_text() == "an older one"


def test_files_appear_together(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "report"
    (tmp_path / "deep" / ".report.new").mkdir(parents=True)  # of a process that was killed
    (tmp_path / "deep" / ".report.new" / "old").touch()
    for text in ("1", "2"):
        with together(folder) as new:
            (new / "a").write_text(text)
            (new / text).touch()
            assert not (folder / text).exists()
        assert (folder / "a").read_text() == text
    assert sorted(path.name for path in folder.iterdir()) == ["1", "2", "a"]
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"out: .*file"), together(tmp_path / "file"):
        pass
    assert [path.name for path in folder.parent.iterdir()] == ["report"]

"""docs/sampler.md keeps its word: its code runs, its output is as shown, its links lead on."""

import os
import re
import subprocess
import sys
from pathlib import Path

import optuna
import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGE = (DOCS / "sampler.md").read_text()
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(?:#([^)\s]*))?\)")


def code_blocks(text: str, language: str = "python") -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def headings(text: str) -> set[str]:
    """Anchors as GitHub makes them: lower case, words joined by hyphens."""
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title).lower().replace(" ", "-") for title in titles}


def test_the_complete_example_runs_in_an_empty_folder(tmp_path: Path) -> None:
    """As a newcomer runs it: a file of its own, a process of its own."""
    (tmp_path / "oven.py").write_text(code_blocks(PAGE)[0])
    done = subprocess.run(
        [sys.executable, "oven.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    shown = code_blocks(PAGE, "text")[0]
    best, promised = (
        float(re.findall(r"best of 20: (\S+)", text)[0]) for text in (done.stdout, shown)
    )
    assert best == pytest.approx(promised, abs=0.01)


@pytest.mark.filterwarnings("ignore::optuna.exceptions.ExperimentalWarning")
def test_all_examples_run_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each goes on from those before, so they share one namespace."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    blocks = code_blocks(PAGE)
    for number, code in enumerate([*blocks, blocks[-1]]):  # the last is a program to run again
        exec(compile(code, f"docs/sampler.md, block {number}", "exec"), names)
    printed = capsys.readouterr().out
    for shown in code_blocks(PAGE, "text")[1:]:
        assert shown in printed
    study = names["study"]
    assert isinstance(study, optuna.Study)
    rows = [trial.user_attrs["row"] for trial in study.trials]
    assert len(set(rows)) == len(rows) == 10  # stopped after five, and went on


@pytest.mark.parametrize("page", sorted(DOCS.glob("sampler*.md")), ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    for file, anchor in LINK.findall(text):
        if "://" in file:
            continue
        target = page.parent / file if file else page
        assert target.exists(), file
        if anchor:
            assert anchor in headings(target.read_text()), f"{file}#{anchor}"

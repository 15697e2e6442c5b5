"""Documents say what the code says: parameters, commands, configurations and files."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import taichi_nmm
from taichi_nmm.config import read_toml
from taichi_nmm.parameters import GAINS, LOW_LEVEL_GAINS, Parameter
from tests.study import fake_walker

ROOT = Path(__file__).resolve().parent.parent
CONFIGS = sorted((ROOT / "configs").glob("*.toml"))


def table_row(parameter: Parameter) -> str:
    """A parameter's row of the table in docs/walker.md."""
    p = parameter
    bounds = f"{p.low:.4g} | {p.high:.4g} | {p.default:.4g}"
    return f"| `{p.name}` | {p.unit} | {bounds} | {p.meaning} | {p.source} |"


@pytest.mark.parametrize("parameter", [*GAINS, *LOW_LEVEL_GAINS], ids=lambda p: p.name)
def test_parameter_table_is_that_of_the_code(parameter: Parameter) -> None:
    assert table_row(parameter) in (ROOT / "docs" / "walker.md").read_text()


@pytest.mark.parametrize("config", CONFIGS, ids=lambda path: path.name)
def test_every_configuration_is_toml_and_its_command_is_named(config: Path) -> None:
    """In a document or, so that an experiment is one file, in its own comments."""
    read_toml(config)
    pages = [config, ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    command = re.compile(rf"tools/\w+\.py .*configs/{re.escape(config.name)}")
    assert any(command.search(page.read_text()) for page in pages)


def test_links_to_files_of_the_repository_lead_somewhere() -> None:
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def python_blocks(page: Path) -> list[str]:
    """The Python code of a page, block by block."""
    return re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)


@pytest.mark.slow
def test_the_readmes_simulation_runs() -> None:
    code = python_blocks(ROOT / "README.md")[0]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "completed" in done.stdout and "(10000, 6)" in done.stdout


@pytest.mark.slow
def test_the_start_pages_walk_prints_what_it_shows() -> None:
    page = ROOT / "docs" / "index.md"
    shown = re.findall(r"```text\n(.*?)```", page.read_text(), flags=re.DOTALL)
    code = python_blocks(page)[0]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert (done.stdout, done.stderr) == (shown[0], "")


@pytest.mark.slow
def test_the_readmes_study_and_the_stores_page_run_on_small_stores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "store").symlink_to(ROOT / "tests" / "assets" / "store-v1")
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    fake_walker.write_store(tmp_path / "out" / "store-diverse")
    blocks = [python_blocks(ROOT / "README.md")[1], python_blocks(ROOT / "docs" / "store.md")[0]]
    for code in blocks:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path
        )
        assert done.returncode == 0, done.stderr

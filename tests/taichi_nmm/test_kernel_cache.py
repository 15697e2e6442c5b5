"""Places for compiled kernels: what Taichi would abort on, or say nothing about, is one line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from taichi_nmm.errors import InputError
from taichi_nmm.kernel_cache import CACHE_VARIABLE, require_kernel_cache

ROOT = Path(__file__).parents[2]
SIMULATE = "import taichi_nmm; taichi_nmm.simulate(taichi_nmm.PUBLISHED_GAINS, duration_s=0.1)"


def test_a_folder_that_can_be_written_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "new" / "cache"))
    require_kernel_cache()
    assert list((tmp_path / "new" / "cache").iterdir()) == []
    monkeypatch.delenv(CACHE_VARIABLE)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    require_kernel_cache()
    assert (tmp_path / "home" / ".cache" / "taichi").is_dir()


def test_a_folder_that_cannot_be_written_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file"))
    with pytest.raises(InputError, match=f"{CACHE_VARIABLE}: .*file.* can be written"):
        require_kernel_cache()
    monkeypatch.delenv(CACHE_VARIABLE)
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    with pytest.raises(InputError, match=r"HOME: .* can be written"):
        require_kernel_cache()


@pytest.mark.slow
def test_without_a_home_a_command_says_one_line_and_makes_nothing(tmp_path: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "HOME"}
    out = tmp_path / "out"
    words = [sys.executable, str(ROOT / "tools" / "walk.py"), "--out", str(out)]
    done = subprocess.run(words, env=environment, cwd=ROOT, capture_output=True, text=True)
    assert done.stderr.startswith("error: HOME: 'unset'") and done.stderr.count("\n") == 1
    assert done.returncode == 2 and not out.exists()


@pytest.mark.slow
def test_without_a_home_a_simulation_is_an_input_error() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "HOME"}
    done = subprocess.run(
        [sys.executable, "-c", SIMULATE], env=environment, cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 1 and "InputError: HOME: 'unset'" in done.stderr

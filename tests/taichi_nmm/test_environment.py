"""Environments that Taichi would crash in, or be changed by: a walk is the same in all of them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from taichi_nmm.kernel_cache import settled_environment
from tests.tools.running import ROOT

ODD = {
    "LC_ALL": "xx",
    "LANG": "xx",
    "TI_ARCH": "zzz",
    "TI_LOG_LEVEL": "zzz",
    "TI_FAST_MATH": "maybe",
    "TI_DEFAULT_FP": "7",
}


def test_variables_are_as_they_were_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in ODD.items():
        monkeypatch.setenv(name, value)
    before = dict(os.environ)
    with settled_environment():
        assert not set(ODD) - {"LC_ALL", "LANG"} & set(os.environ)
        os.environ["TI_OF_TAICHI"] = "kept"
    assert os.environ.pop("TI_OF_TAICHI") == "kept"
    assert dict(os.environ) == before


@pytest.mark.slow
def test_a_walk_is_the_same_in_an_odd_environment_and_without_docstrings(tmp_path: Path) -> None:
    words = [ROOT / "tools" / "walk.py", "--duration", "2", "--movie-seconds", "0", "--json"]
    said = []
    for flags, odd in (([], {}), (["-OO"], ODD)):
        done = subprocess.run(
            [sys.executable, *flags, *words],
            cwd=tmp_path, env={**os.environ, **odd}, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        said.append(done.stdout)
    assert said[0] == said[1]


@pytest.mark.slow
def test_nothing_is_said_where_standard_output_is_a_notebooks() -> None:
    code = "import io, sys; sys.stdout = io.StringIO(); import taichi_nmm.simulator"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")

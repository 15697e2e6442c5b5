"""Environments that would abort or change Taichi: an error of one line, or no difference."""

import os

import pytest

from taichi_nmm import kernel_cache
from taichi_nmm.kernel_cache import (
    CACHE_VARIABLE,
    COMPILER,
    PREFIX,
    require_kernel_cache,
)
from tests.cases import refused
from tests.processes import ROOT, python

WALK = ROOT / "tools" / "walk.py"
SIMULATE = (
    "import taichi_nmm; taichi_nmm.simulate(taichi_nmm.PUBLISHED_GAINS, duration_s=0.1)"
)
WALKED = "import taichi_nmm as t; "
WALKED += "print(t.simulate(t.PUBLISHED_GAINS, duration_s=0.5).rows.tobytes().hex())"
NOTEBOOK = "import io, sys; sys.stdout = io.StringIO(); import taichi_nmm.simulator"
ODD = {
    "LC_ALL": "xx",
    "LANG": "xx",
    f"{PREFIX}ARCH": "zzz",
    f"{PREFIX}LOG_LEVEL": "zzz",
}
ODD |= {f"{PREFIX}FAST_MATH": "maybe", f"{PREFIX}DEFAULT_FP": "7"}


def test_a_cache_must_be_writable(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "new" / "cache"))
    require_kernel_cache()
    assert list((tmp_path / "new" / "cache").iterdir()) == []
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file"))
    with refused(f"{CACHE_VARIABLE}: .*file.* can be written"):
        require_kernel_cache()
    monkeypatch.delenv(CACHE_VARIABLE)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    require_kernel_cache()
    assert (tmp_path / "home" / ".cache" / COMPILER).is_dir()
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    with refused(r"HOME: .* can be written"):
        require_kernel_cache()


@pytest.mark.slow
def test_without_a_home_a_command_and_a_simulation_say_one_line(tmp_path):
    homeless = {name: value for name, value in os.environ.items() if name != "HOME"}
    out = tmp_path / "out"
    done = python(WALK, "--out", out, env=homeless)
    assert (
        done.stderr.startswith("error: HOME: 'unset'") and done.stderr.count("\n") == 1
    )
    assert done.returncode == 2 and not out.exists()
    done = python("-c", SIMULATE, env=homeless)
    assert done.returncode == 1 and "InputError: HOME: 'unset'" in done.stderr


def test_variables_are_as_they_were_afterwards(monkeypatch):
    for name, value in ODD.items():
        monkeypatch.setenv(name, value)
    before = dict(os.environ)
    with kernel_cache.settled_environment():
        assert not set(ODD) - {"LC_ALL", "LANG"} & set(os.environ)
        os.environ[f"{PREFIX}OF_TAICHI"] = "kept"
    assert os.environ.pop(f"{PREFIX}OF_TAICHI") == "kept"
    assert dict(os.environ) == before


@pytest.mark.slow
def test_a_walk_is_the_same_in_an_odd_environment_and_without_docstrings():
    """And nothing else is printed."""
    plain, odd = python("-c", WALKED), python("-OO", "-c", WALKED, env=os.environ | ODD)
    assert (plain.returncode, plain.stderr, odd.returncode, odd.stderr) == (
        0,
        "",
        0,
        "",
    )
    assert odd.stdout == plain.stdout and plain.stdout.strip().isalnum()


@pytest.mark.slow
def test_nothing_is_printed_where_standard_output_is_a_notebooks():
    done = python("-c", NOTEBOOK)
    assert (done.returncode, done.stderr) == (0, "")

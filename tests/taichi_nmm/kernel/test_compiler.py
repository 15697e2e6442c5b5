"""The insides of the compiler that runs here: Taichi 1.7.4 or, on Python 3.14, Quadrants 1.4.0."""

import subprocess
import sys
from importlib.metadata import version

import pytest

from taichi_nmm.kernel import backend, compiler
from taichi_nmm.kernel_cache import COMPILER
from taichi_nmm.settings import Settings

PINNED = {"taichi": "1.7.4", "quadrants": "1.4.0"}
QUIET = (
    "import taichi_nmm as t; "
    "t.simulate(t.PUBLISHED_GAINS, duration_s=0.1, settings=t.Settings(arch='cpu'))"
)


def test_each_python_has_its_compiler_and_results_name_it() -> None:
    assert ("quadrants" if sys.version_info >= (3, 14) else "taichi") == COMPILER
    assert compiler.VERSION == version(COMPILER) == PINNED[COMPILER]
    backend.start(Settings(arch="cpu"))
    engine = backend.metadata()
    assert (engine["engine"], engine["engine_version"]) == (COMPILER, PINNED[COMPILER])
    assert compiler.ti.__name__ == COMPILER


def test_the_source_of_a_kernel_is_read_once_and_no_class_is_looked_for() -> None:
    module = compiler.kernel_impl if COMPILER == "taichi" else compiler.ti.lang._func_base
    name = "getsourcelines" if COMPILER == "taichi" else "get_source_info_and_src"
    assert hasattr(getattr(module, name), "cache_info")
    assert compiler.kernel_impl._inside_class is compiler._inside_class


@pytest.mark.slow
def test_nothing_is_printed() -> None:
    done = subprocess.run([sys.executable, "-c", QUIET], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")

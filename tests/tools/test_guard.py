"""What ends every command in one line: Ctrl-C at any import, packages missing, broken or hidden."""

import sys

import pytest

from study.options import COMMANDS
from taichi_nmm.kernel_cache import COMPILER
from tests.processes import ROOT, python
from tests.tools import running
from tests.tools.running import INTERRUPTED, run_with_accident

pytestmark = pytest.mark.slow

WALK = ("walk", "--duration", 1, "--movie-seconds", 0)
# The tools beside the commands, and one command: all commands begin in study/cli.py.
TOOLS = ["walk", *(tool for tool in running.TOOLS if tool not in COMMANDS)]
FIRST = dict.fromkeys(TOOLS, "numpy") | {"time_walks": "taichi_nmm.settings"}


@pytest.mark.parametrize("tool", TOOLS)
def test_ctrl_c_during_imports_is_one_line(tool, tmp_path):
    done = run_with_accident(
        tmp_path, [ROOT / "tools" / f"{tool}.py"], interrupted=FIRST[tool]
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", f"{INTERRUPTED}\n")


def last_line(done, code):
    """What a command ends with that prints nothing else than progress."""
    assert (done.returncode, done.stdout) == (code, "")
    assert "Traceback" not in done.stderr
    return done.stderr.splitlines(keepends=True)[-1]


@pytest.mark.parametrize("package", [COMPILER, "matplotlib"])
def test_ctrl_c_during_a_late_import_is_one_line(package, tmp_path):
    done = run_with_accident(tmp_path, ("-m", "taichi_nmm", *WALK), interrupted=package)
    assert last_line(done, 130) == f"{INTERRUPTED}\n"


@pytest.mark.parametrize(
    ("words", "package"),
    [
        (("walk",), COMPILER),
        (WALK, "matplotlib"),
        (("walk",), "imageio_ffmpeg"),
        (("dashboard",), "optuna_dashboard"),
    ],
)
def test_a_missing_package_is_said(words, package, tmp_path):
    done = run_with_accident(tmp_path, ("-m", "taichi_nmm", *words), missing=[package])
    line = last_line(done, 2)
    assert line.startswith("error: ") and package in line.replace("-", "_")


@pytest.mark.parametrize(
    "words", [("-m", "taichi_nmm"), ("-m", "taichi_nmm", "walk"), *TOOLS]
)
def test_a_system_without_posix_is_one_line(words, tmp_path):
    """As Windows, where files are locked otherwise."""
    called = [ROOT / "tools" / f"{words}.py"] if isinstance(words, str) else words
    done = run_with_accident(tmp_path, called, missing=("fcntl", "resource"))
    line = f"error: machine: {sys.platform!r} cannot be used; allowed: Linux; on Windows, its WSL\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", line)


def test_a_library_that_a_package_needs_and_the_machine_lacks(tmp_path):
    """As Taichi without libX11."""
    package = tmp_path / "site" / COMPILER
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(
        f"print('advice')\nfrom {COMPILER} import core\n"
    )
    (package / "core.abi3.so").write_bytes(b"")
    done = run_with_accident(tmp_path, ("-m", "taichi_nmm", *WALK))
    assert last_line(done, 2) == (
        f"error: core: '{package / 'core.abi3.so'}: file too short' cannot be used; "
        "allowed: a machine with the libraries that core needs (README.md)\n"
    )


@pytest.mark.parametrize("hidden", ["study.py", "storage.py", "study/__init__.py"])
def test_a_file_that_hides_a_package_of_ours_is_named(hidden, tmp_path):
    file = tmp_path / hidden
    file.parent.mkdir(exist_ok=True)
    file.write_text("raise RuntimeError('a file of the user was run')\n")
    done = run_with_accident(tmp_path, ("-m", "taichi_nmm", "walk", "--help"))
    name = file.relative_to(tmp_path).parts[0].removesuffix(".py")
    said = f"another name, or working directory: it hides {name} of taichi-nmm"
    line = f"error: {name}: '{file}' cannot be used; allowed: {said}\n"
    assert last_line(done, 2) == done.stderr == line
    tool = ROOT / "tools" / "walk.py"  # from a script it hides nothing
    assert python(tool, "--help", cwd=tmp_path).returncode == 0


def test_a_hidden_package_is_named_where_ours_is_imported(tmp_path):
    (tmp_path / "storage.py").write_text(
        "raise RuntimeError('a file of the user was run')\n"
    )
    done = run_with_accident(tmp_path, ("-c", "from study import FeatureTable"))
    line = f"storage: '{tmp_path / 'storage.py'}' cannot be used; allowed: another name"
    assert done.returncode == 1 and line in done.stderr.splitlines()[-1]

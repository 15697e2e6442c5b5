"""What a wheel installs, in an environment of its own that has the packages but no checkout."""

import json
import re
import shlex
import shutil
import subprocess
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
import yaml

import taichi_nmm
from study.options import shipped_configs
from tests.processes import ROOT, printed

pytestmark = pytest.mark.slow

SOURCES = ("taichi_nmm", "storage", "study", "configs", "pyproject.toml", "README.md")
MOST_BYTES = 2_000_000
PIP = ("-m", "pip", "--disable-pip-version-check")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A copy of what wheels are built of: a build leaves folders in its source."""
    source = tmp_path_factory.mktemp("source")
    for name in SOURCES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
        copy(ROOT / name, source / name)
    return source


def built(source, folder):
    """The wheel of a folder with a pyproject.toml."""
    offline = ("--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder)
    printed(*PIP, "wheel", source, *offline)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def wheel(source, tmp_path_factory):
    return built(source, tmp_path_factory.mktemp("wheel"))


class Installed:
    """A fresh environment with the wheel, and an empty folder to work in."""

    def __init__(self, folder, wheel):
        self.folder = folder / "work"
        self.folder.mkdir()
        self.bin = folder / "env" / "bin"
        venv.create(folder / "env", symlinks=True)
        python = str(self.bin / "python")
        asked = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
        sites = subprocess.check_output(asked, text=True)
        # Packages of this environment are seen; its .pth files, which know the
        # checkout, are not.
        others = {sysconfig.get_path(kind) for kind in ("purelib", "platlib")}
        (Path(sites.strip()) / "others.pth").write_text("\n".join(sorted(others)))
        options = ("--no-deps", "--no-index", "--ignore-installed", wheel)
        printed(*PIP, "--python", python, "install", *options)

    def run(self, line):
        """What a command line prints, of a program of the environment in the empty folder."""
        program, *words = shlex.split(line)
        with pytest.MonkeyPatch.context() as patch:
            patch.delenv("PYTHONPATH", raising=False)
            command = [self.bin / program, *words]
            done = subprocess.run(
                command, cwd=self.folder, capture_output=True, text=True
            )
        assert done.returncode == 0, done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    return Installed(tmp_path_factory.mktemp("installed"), wheel)


def test_it_holds_every_configuration_and_every_file_of_the_packages(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    for path in (ROOT / "configs").glob("*.toml"):
        assert f"study/configs/{path.name}" in names
    for package in SOURCES[:3]:
        for path in (ROOT / package).rglob("*"):
            if path.is_file() and not {"__pycache__", "hub"} & set(path.parts):
                assert str(path.relative_to(ROOT)) in names
    tops = {name.split("/")[0] for name in names}
    assert not tops & {"tests", "tools", "docs", "configs"}
    assert wheel.stat().st_size < MOST_BYTES


def test_it_is_not_the_checkout_that_is_run(installed):
    for package in ("taichi_nmm", "storage", "study"):
        place = installed.run(
            f"python -c 'import {package}; print({package}.__file__)'"
        )
        assert Path(place).is_relative_to(installed.bin.parent)


def test_the_commands_explain_themselves_and_list_configurations(installed):
    for line in ("taichi-nmm --help", "python -m taichi_nmm"):
        said = installed.run(line)
        assert "walk  " in said and "validate  " in said
    assert "--list-configs" in installed.run("taichi-nmm walk --help")
    for command, of_stores in (("precompute", True), ("study", False)):
        lines = installed.run(f"taichi-nmm {command} --list-configs").splitlines()
        listed = dict(line.split(maxsplit=1) for line in lines)
        assert listed.keys() == set(shipped_configs(stores=of_stores))
    assert "first experiment" in listed["rough8-smooth"]


def test_the_main_job_is_done_by_name(installed):
    """A store, a study that reads it, and a walk of what was found."""

    def printed(line):
        return json.loads(installed.run(f"taichi-nmm {line} --json"))

    made = printed("precompute --config store --samples 64 --workers 1")
    assert made["path"] == "out/store"
    where = "--trials 2 --storage sqlite:///studies.db"
    found = printed(f"study --config rough8 --arm dog {where}")
    assert found["trials"] == 2
    walked = printed(f"walk --gains {found['gains']} --duration 2 --movie-seconds 0")
    assert (installed.folder / walked["pictures"]["strip"]).is_file()


def test_all_say_the_same_version(wheel):
    assert wheel.name.split("-")[1] == taichi_nmm.__version__
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == taichi_nmm.__version__
    released = r"^## (\S+) \((\d{4}-.*)\)$"
    newest, *_ = re.findall(released, (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert newest == (taichi_nmm.__version__, str(citation["date-released"]))


# Nothing of the simulator can be imported, and Arrow only in the end.
ALONE = """
import sys
sys.modules["pyarrow"] = sys.modules["taichi"] = None
import optuna
from study import FeatureKernelSampler, FeatureTable

table = FeatureTable.from_arrays({"x": [0.0, 1.0, 2.0, 3.0]}, [[9.0], [4.0], [1.0], [0.0]])
study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
study.optimize(lambda trial: trial.suggest_float("x", 0, 3) ** 2, n_trials=4)
print(study.best_value)
for names in {"parameters": ["x"]}, {}:
    try:
        FeatureTable.from_parquet("a.parquet", features=["y"], **names)
    except ValueError as error:
        print(str(error).split("allowed: ")[1])
    sys.modules.pop("pyarrow", None)
"""


def test_the_sampler_alone_is_light(source, tmp_path_factory):
    wheel = built(source / "study" / "hub", tmp_path_factory.mktemp("alone"))
    parts = zipfile.ZipFile(wheel)
    assert not [name for name in parts.namelist() if name.startswith("taichi_nmm/")]
    (metadata,) = (name for name in parts.namelist() if name.endswith("METADATA"))
    needed = re.findall(
        r"^Requires-Dist: (\w+)[^;\n]*$", parts.read(metadata).decode(), re.M
    )
    assert needed == ["numpy", "scipy", "optuna", "threadpoolctl"]  # and extras
    alone = Installed(tmp_path_factory.mktemp("alone-installed"), wheel)
    allowed = (
        "an installed pyarrow, which reads it",
        "columns; only taichi-nmm whole reads stores",
    )
    said = alone.run(f"python -c {shlex.quote(ALONE)}")
    assert said.splitlines() == ["0.0", *allowed]

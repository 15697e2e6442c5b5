"""The OptunaHub packages load from disk, as from the registry, and their pages' examples run."""

import importlib
import os
import pickle
import re
import sys
from itertools import product
from pathlib import Path
from types import ModuleType

import optuna
import pytest
import yaml

import study

ROOT = Path(__file__).parents[2]
REGISTRY = ROOT / "study" / "hub" / "package"
FOLDER = REGISTRY / "samplers" / "feature_kernel"


@pytest.fixture(scope="module")
def optunahub():
    # nothing is cloned: git may be missing
    os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
    return importlib.import_module("optunahub")


def load(optunahub):
    module = optunahub.load_local_module(
        "samplers/feature_kernel", registry_root=str(REGISTRY)
    )
    assert isinstance(module, ModuleType)
    return module


def test_it_loads_the_one_sampler_there_is_which_unpickles_without_the_hub(optunahub):
    module = load(optunahub)
    assert module.__name__ == "optunahub_registry.package.samplers.feature_kernel"
    for name in module.__all__:
        assert getattr(module, name) is getattr(study, name)
    table = module.FeatureTable.from_arrays(
        {"x": [0.0, 1.0, 2.0]}, [[0.0], [1.0], [4.0]]
    )
    data = pickle.dumps(module.FeatureKernelSampler(table, seed=1))
    assert b"optunahub" not in data
    assert type(pickle.loads(data)) is study.FeatureKernelSampler


@pytest.fixture
def examples(optunahub, monkeypatch):
    """The README's programs, with the local registry in the place of the one on the net."""
    text = (FOLDER / "README.md").read_text()
    monkeypatch.setattr(optunahub, "load_module", lambda name: load(optunahub))
    found = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    return [compile(code, "README.md", "exec") for code in found]


def test_the_readmes_example_runs(examples, capsys):
    names = {}
    exec(examples[0], names)
    found = names["study"]
    assert isinstance(found, optuna.Study)
    assert abs(found.best_params["x"] - 1.0) < 0.5
    assert str(found.best_params) in capsys.readouterr().out


def test_the_readmes_measured_example_runs(examples, capsys, monkeypatch, tmp_path):
    """On made-up yields of three pairs: the base decides, and the third pair likes another."""
    _, example = examples
    names = ("Electrophile", "Nucleophile", "Ligand", "Base", "Solvent")
    lines = [",".join([*(f"{name}_SMILES" for name in names), "yield"])]
    bases = {"A": (90, 10, 20, 30), "B": (80, 20, 30, 10), "C": (10, 20, 30, 80)}
    for pair, base, ligand, solvent in product(bases, range(4), "PQ", "uv"):
        reached = bases[pair][base] + (ligand == "P")
        lines.append(f"{pair},N,{ligand},b{base},{solvent},{reached}")
    (tmp_path / "experiment_index.csv").write_text("\n".join(lines))
    monkeypatch.chdir(tmp_path)
    exec(example, {})
    said = re.search(r"ours (\S+) %, the ranking (\S+) %", capsys.readouterr().out)
    ours, ranking = map(float, said.groups())
    # of C the ranking tries b0 four times and b2 once: 31 % in place of 81 %
    assert ranking == pytest.approx((81 - 31) / 3, abs=0.06)
    assert 0.0 <= ours <= ranking


def test_without_taichi_nmm_the_error_says_what_to_install(optunahub, monkeypatch):
    monkeypatch.setitem(sys.modules, "study", None)  # as if it were not there
    with pytest.raises(
        ImportError, match=r"needs taichi-nmm-sampler: install it as its README"
    ):
        load(optunahub)


def test_files_and_front_matter_are_what_the_registry_asks_for(optunahub):
    files = {path.name for path in FOLDER.iterdir() if path.name != "__pycache__"}
    assert files == {"README.md", "LICENSE", "__init__.py"}  # and no data
    assert (FOLDER / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()
    readme = (FOLDER / "README.md").read_text()
    # all must be strings
    front = yaml.load(readme.split("---\n")[1], Loader=yaml.BaseLoader)
    assert set(front) == {
        "author",
        "title",
        "description",
        "tags",
        "optuna_versions",
        "license",
    }
    assert "sampler" in front["tags"] and all(front.values())
    assert optuna.__version__ in front["optuna_versions"]
    assert front["license"] == "MIT License"
    assert not re.search(r"<\w+[ >/]", readme)  # its page shows no HTML
    assert issubclass(load(optunahub).FeatureKernelSampler, optuna.samplers.BaseSampler)
    for method in re.findall(r"`FeatureTable\.(\w+)", readme):
        assert callable(getattr(study.FeatureTable, method))

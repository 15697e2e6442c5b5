"""The OptunaHub packages load from disk, as from the registry, and their pages' examples run."""

import importlib
import os
import pickle
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import optuna
import pytest
import yaml

import study

ROOT = Path(__file__).parents[2]
REGISTRY = ROOT / "study" / "hub" / "package"
SAMPLERS = {"feature_kernel": "FeatureKernelSampler", "pool": "PoolSampler"}  # one class a package


@pytest.fixture(scope="module")
def optunahub():
    os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")  # nothing is cloned: git may be missing
    return importlib.import_module("optunahub")


def folder(package: str) -> Path:
    return REGISTRY / "samplers" / package


def load(optunahub: ModuleType, package: str = "feature_kernel") -> ModuleType:
    module = optunahub.load_local_module(f"samplers/{package}", registry_root=str(REGISTRY))
    assert isinstance(module, ModuleType)
    return module


def test_it_loads_the_one_sampler_there_is_which_unpickles_without_the_hub(optunahub):
    module = load(optunahub)
    assert module.__name__ == "optunahub_registry.package.samplers.feature_kernel"
    for name in module.__all__:
        assert getattr(module, name) is getattr(study, name)
    table = module.FeatureTable.from_arrays({"x": [0.0, 1.0, 2.0]}, [[0.0], [1.0], [4.0]])
    data = pickle.dumps(module.FeatureKernelSampler(table, seed=1))
    assert b"optunahub" not in data
    assert type(pickle.loads(data)) is study.FeatureKernelSampler


def test_a_pool_is_a_table_of_that_similarity(optunahub):
    sampler = load(optunahub, "pool").PoolSampler
    ring = np.roll(np.eye(12), 1, axis=0) + np.roll(np.eye(12), -1, axis=0)
    gram, names = ring + 2.0 * np.eye(12), {"node": [f"n{number}" for number in range(12)]}
    both = [
        (sampler(kernel=gram, seed=2), study.FeatureTable.from_kernel(gram)),
        (sampler(gram, candidates=names, seed=2), study.FeatureTable.from_kernel(gram, names)),
        (sampler(graph=ring, hops=3.0, seed=2), study.FeatureTable.from_graph(ring, hops=3.0)),
    ]
    for ours, table in both:
        theirs, space = study.FeatureKernelSampler(table, seed=2), table.rows.space.as_dict()
        assert trials_of(ours, space) == trials_of(theirs, space)
    for wrong in ({}, {"kernel": gram, "graph": ring}):
        with pytest.raises(ValueError, match=r"one of kernel= and graph="):
            sampler(**wrong)


def trials_of(sampler: optuna.samplers.BaseSampler, space: dict[str, Any]) -> list[Any]:
    """What a sampler tries of twelve candidates, six times."""
    found = optuna.create_study(sampler=sampler)
    for value in (3.0, 1.0, 2.0, 5.0, 4.0, 6.0):
        found.tell(found.ask(space), value)
    return [trial.params for trial in found.trials]


@pytest.mark.parametrize("package", SAMPLERS)
def test_the_readmes_example_runs(optunahub, package, monkeypatch, capsys):
    """With the local registry in the place of the one on the net."""
    text = (folder(package) / "README.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.setattr(optunahub, "load_module", lambda name: load(optunahub, Path(name).name))
    names: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), names)
    found = names["study"]
    assert isinstance(found, optuna.Study)
    if package == "pool":  # among the best five of 500, after 20 trials
        assert found.best_value >= np.sort(np.asarray(names["binding"]))[-5]
    else:
        assert abs(found.best_params["x"] - 1.0) < 0.5
    assert str(found.best_params) in capsys.readouterr().out


@pytest.mark.parametrize("package", SAMPLERS)
def test_without_taichi_nmm_the_error_says_what_to_install(optunahub, package, monkeypatch):
    monkeypatch.setitem(sys.modules, "study", None)  # as if it were not there
    with pytest.raises(ImportError, match=r"needs taichi-nmm-sampler: install it as its README"):
        load(optunahub, package)


@pytest.mark.parametrize(("package", "name"), SAMPLERS.items())
def test_files_and_front_matter_are_what_the_registry_asks_for(optunahub, package, name):
    files = {path.name for path in folder(package).iterdir() if path.name != "__pycache__"}
    assert files == {"README.md", "LICENSE", "__init__.py"}  # and no data
    assert (folder(package) / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()
    readme = (folder(package) / "README.md").read_text()
    front = yaml.load(readme.split("---\n")[1], Loader=yaml.BaseLoader)  # all must be strings
    assert set(front) == {"author", "title", "description", "tags", "optuna_versions", "license"}
    assert "sampler" in front["tags"] and all(front.values())
    assert optuna.__version__ in front["optuna_versions"]
    assert front["license"] == "MIT License"
    assert not re.search(r"<\w+[ >/]", readme)  # its page shows no HTML
    assert issubclass(getattr(load(optunahub, package), name), optuna.samplers.BaseSampler)
    for method in re.findall(r"`FeatureTable\.(\w+)", readme):
        assert callable(getattr(study.FeatureTable, method))

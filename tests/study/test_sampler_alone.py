"""The samplers, tables and stores where only what the sampler alone asks for is installed."""

import re
import tomllib

import pytest

import taichi_nmm
from tests.study import fake_walker
from tests.tools.running import ROOT, run_with_accident

pytestmark = pytest.mark.slow

MOST_IMPORT_S = 2.0  # of the processor: a busy machine is no slower program
MODULES = {"scikit-learn": "sklearn", "pillow": "PIL"}
OPTUNA_HAS = {"tqdm"}

PROGRAM = f"""
import time
began_s = time.process_time()
import optuna
import study
for name in study.__all__:
    getattr(study, name)
assert time.process_time() - began_s < {MOST_IMPORT_S}
import numpy as np
from study import DoGSampler, FeatureKernelSampler, FeatureTable, world_table

optuna.logging.set_verbosity(optuna.logging.ERROR)
xs = np.linspace(0.0, 1.0, 50)
of_arrays = FeatureTable.from_arrays({{"x": xs}}, np.sin(3 * xs)[:, None])
of_store = FeatureTable.from_parquet("store", features=["phi_printed"])
samplers = (
    FeatureKernelSampler(of_arrays, seed=1),
    DoGSampler(of_store, seed=1),
    FeatureKernelSampler(world_table("store"), seed=1),
)
for sampler in samplers:
    names = ["x"] if sampler is samplers[0] else {list(taichi_nmm.GAIN_NAMES)}
    ends = [(0.0, 1.0)] if sampler is samplers[0] else {[(g.low, g.high) for g in taichi_nmm.GAINS]}
    tried = optuna.create_study(sampler=sampler)
    tried.optimize(
        lambda trial: sum(trial.suggest_float(n, *e) for n, e in zip(names, ends)), n_trials=4
    )
print("done")
"""


def packages_of_the_sampler():
    """What the sampler alone asks for, with Arrow for stores."""
    path = ROOT / "study" / "hub" / "pyproject.toml"
    project = tomllib.loads(path.read_text())["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["parquet"]]
    return {re.split(r"[<>=]", words)[0] for words in asked}


def test_a_study_without_simulator_pictures_and_dashboard(tmp_path):
    fake_walker.write_store(tmp_path / "store")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    dependencies = {re.split(r"[<>=]", words)[0] for words in project["dependencies"]}
    there = packages_of_the_sampler()
    assert there <= dependencies
    missing = dependencies - there - OPTUNA_HAS
    assert {
        "taichi",
        "quadrants",
        "matplotlib",
        "imageio-ffmpeg",
        "optuna-dashboard",
    } <= missing
    modules = [MODULES.get(name, name.replace("-", "_")) for name in missing]
    done = run_with_accident(tmp_path, ("-c", PROGRAM), missing=modules)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr

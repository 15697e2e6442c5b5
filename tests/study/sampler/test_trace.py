"""A proposal is followed on a few screens: files and classes that it passes through are few."""

import sys
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import optuna

from study import FeatureKernelSampler, FeatureTable

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = tuple(str(ROOT / package) for package in ("study", "storage", "taichi_nmm"))


def test_a_proposal_passes_few_files_and_classes() -> None:
    rng = np.random.default_rng(1)
    columns = dict(zip("abcd", rng.random((4, 200)), strict=True))
    table = FeatureTable.from_arrays(columns, rng.random((200, 3)))
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
    calls: Counter[tuple[str, str]] = Counter()  # of files and functions of this project

    def trace(frame: FrameType, event: str, argument: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGES):
            file = Path(code.co_filename).relative_to(ROOT).as_posix()
            calls[file, code.co_qualname.partition(".<locals>")[0]] += 1

    def objective(trial: optuna.Trial) -> float:
        found = [trial.suggest_float(name, x.min(), x.max()) for name, x in columns.items()]
        return float(((np.array(found) - 0.5) ** 2).sum())

    study.optimize(objective, n_trials=10)
    sys.setprofile(trace)
    try:
        objective(study.ask())
    finally:
        sys.setprofile(None)
    files = {file for file, _ in calls}
    classes = {name.rpartition(".")[0] for _, name in calls} - {""}
    assert calls["study/sampler/sampler.py", "FeatureKernelSampler.sample_relative"]
    assert len(files) <= 10, sorted(files)  # 34 files and 26 classes in 0.2.0
    assert len(classes) <= 10, sorted(classes)

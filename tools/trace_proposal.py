"""Trace one proposal of the feature-kernel sampler: the files, classes and functions it runs.

    python tools/trace_proposal.py

The proposal is the eleventh of a study over a table of 200 rows with three features. Calls of this
project's functions are counted with `sys.setprofile`. A test holds the numbers of files and
classes. Exit codes: 0, 2 bad input.
"""

import sys
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    import optuna

    from study import FeatureKernelSampler, FeatureTable
    from study.options import Options

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = tuple(str(ROOT / package) for package in ("study", "storage", "taichi_nmm"))
ROWS, TRIALS_BEFORE = 200, 10

Calls = Counter[tuple[str, str]]
"""How often each function ran, by its file and its name: "Class.method"."""


def calls_of_a_proposal() -> Calls:
    """One proposal over a table, from `ask` to the last suggested parameter."""
    rng = np.random.default_rng(1)
    columns = dict(zip("abcd", rng.random((4, ROWS)), strict=True))
    table = FeatureTable.from_arrays(columns, rng.random((ROWS, 3)))
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
    calls: Calls = Counter()

    def count(frame: FrameType, event: str, argument: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGES):
            file = Path(code.co_filename).relative_to(ROOT).as_posix()
            calls[file, code.co_qualname.partition(".<locals>")[0]] += 1

    def objective(trial: optuna.Trial) -> float:
        found = [trial.suggest_float(name, x.min(), x.max()) for name, x in columns.items()]
        return float(((np.array(found) - 0.5) ** 2).sum())

    study.optimize(objective, n_trials=TRIALS_BEFORE)
    sys.setprofile(count)
    try:
        objective(study.ask())
    finally:
        sys.setprofile(None)
    return calls


def files_and_classes(calls: Calls) -> tuple[list[str], list[str]]:
    """The files whose functions ran, and the classes whose methods did."""
    classes = {name.rpartition(".")[0] for _, name in calls} - {""}
    return sorted({file for file, _ in calls}), sorted(classes)


def main() -> None:
    """Print the trace."""
    Options(__file__).parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    calls = calls_of_a_proposal()
    files, classes = files_and_classes(calls)
    print(f"{len(files)} files, {len(classes)} classes, {len(calls)} functions")
    print(f"classes: {', '.join(classes)}")
    for file in files:
        print(f"\n{file}")
        for (owner, name), count in calls.most_common():
            if owner == file:
                print(f"  {count:5} {name}")


if __name__ == "__main__":
    run_command(main)

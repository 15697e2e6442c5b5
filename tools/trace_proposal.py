"""Trace one proposal of the feature-kernel sampler: the files, classes and functions it runs.

    python tools/trace_proposal.py

The proposal is the eleventh of a study over a table of 200 rows with three features. What runs is
counted with `sys.setprofile`: calls of this project's functions, by file, and the classes whose
methods ran. A test holds the numbers of files and classes. Exit codes: 0, 2 bad input.
"""

import sys
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    import optuna

    from study import FeatureKernelSampler, FeatureTable
    from study.options import Options

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = tuple(str(ROOT / package) for package in ("study", "storage", "taichi_nmm"))
ROWS, TRIALS_BEFORE = 200, 10


class Trace:
    """Calls by file and by function, and the names of the classes whose methods ran."""

    def __init__(self) -> None:
        self.files: Counter[str] = Counter()
        self.functions: Counter[tuple[str, str]] = Counter()
        self.classes: set[str] = set()

    def __call__(self, frame: FrameType, event: str, argument: Any) -> None:
        """Count one call (the profile function of `sys.setprofile`)."""
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(PACKAGES):
            return
        file = str(Path(code.co_filename).relative_to(ROOT))
        self.files[file] += 1
        self.functions[file, code.co_qualname] += 1
        owner, _, _ = code.co_qualname.partition(".<locals>")[0].rpartition(".")
        if owner:
            self.classes.add(owner)


def traced_proposal() -> Trace:
    """One proposal over a table, from `ask` to the last suggested parameter."""
    rng = np.random.default_rng(1)
    names = ("a", "b", "c", "d")
    columns = dict(zip(names, rng.random((len(names), ROWS)), strict=True))
    table = FeatureTable.from_arrays(columns, rng.random((ROWS, 3)))
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))

    def objective(trial: optuna.Trial) -> float:
        found = [trial.suggest_float(name, x.min(), x.max()) for name, x in columns.items()]
        return float(((np.array(found) - 0.5) ** 2).sum())

    study.optimize(objective, n_trials=TRIALS_BEFORE)
    trace = Trace()
    sys.setprofile(trace)
    try:
        objective(study.ask())
    finally:
        sys.setprofile(None)
    return trace


def main() -> None:
    """Print the trace."""
    Options(__file__).parse_args()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    trace = traced_proposal()
    print(
        f"{len(trace.files)} files, {len(trace.classes)} classes, "
        f"{len(trace.functions)} functions, {trace.functions.total()} calls"
    )
    print(f"classes: {', '.join(sorted(trace.classes))}")
    for file, calls in trace.files.most_common():
        print(f"\n{file}: {calls} calls")
        for (owner, name), count in trace.functions.most_common():
            if owner == file:
                print(f"  {count:5} {name}")


if __name__ == "__main__":
    run_command(main)

"""Finished runs of a comparison, a file each: what is missing or was made by other code is run."""

import ast
import hashlib
import importlib.util
import json
import multiprocessing
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import optuna
from numpy.typing import NDArray
from tqdm import tqdm

from storage.commit import commit_json
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]
Costs = dict[tuple[str, str], Floats]  # of a problem and an arm, [seeds, trials]

ROOT = Path(__file__).resolve().parents[2]
# What decides our arms beside a benchmark's own files.
OUR_SOURCES = (
    ROOT / "study" / "draws.py",
    *sorted((ROOT / "study" / "sampler").glob("*.py")),
)
OUR_PACKAGES = ("numpy", "scipy", "optuna", "scikit-learn")
PEER_PACKAGES = ("numpy", "scipy", "optuna", "cmaes", "torch")
# For the processes that are started: their BLAS reads it when NumPy is imported.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Run(Protocol):
    """One study: a problem, an arm, a seed, a number of trials. A frozen dataclass of plain values.

    It is sent to another process, so its class must be found by an import there.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def problem(self) -> str:
        """Name of the problem."""

    @property
    def arm(self) -> str:
        """Name of the arm."""

    def file(self, cache: Path) -> Path:
        """Where its result is kept."""

    def code(self) -> str:
        """Fingerprint of all that decides its costs."""

    def costs(self) -> Floats:
        """Run it: costs of its trials in their order, [trials]."""


def execute(runs: Sequence[Run], cache: Path, processes: int) -> None:
    """Run what the cache has not got, each study in one process."""
    missing = {run.file(cache): run for run in runs if not is_current(run, cache)}
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(processes, mp_context=context) as pool,
        tqdm(total=len(missing), unit="run", disable=not missing) as bar,
    ):
        futures = [pool.submit(execute_one, run, file) for file, run in missing.items()]
        try:
            for future in as_completed(futures):
                future.result()
                bar.update()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def execute_one(run: Run, file: Path) -> None:
    """Run one study and keep its costs."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    began = time.perf_counter()
    costs = run.costs()
    result = {
        "code": run.code(),
        "run": asdict(run),
        "seconds": time.perf_counter() - began,
        "costs": costs.tolist(),
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    commit_json(file, result)


def is_current(run: Run, cache: Path) -> bool:
    """Whether the cache has this run, made by the present code."""
    try:
        return bool(_read(run.file(cache))["code"] == run.code())
    except (OSError, ValueError, KeyError):
        return False


def collect(runs: Sequence[Run], cache: Path) -> Costs:
    """Costs of every problem and arm, the seeds in their order."""
    found: dict[tuple[str, str], list[list[float]]] = {}
    for run in runs:
        found.setdefault((run.problem, run.arm), []).append(_read(run.file(cache))["costs"])
    return {key: np.array(costs) for key, costs in found.items()}


def fingerprint(sources: Iterable[Path], packages: Iterable[str], *others: str) -> str:
    """Of source files, versions of packages, and anything else that decides a run."""
    digest = hashlib.sha256()
    for file in sources:
        # Not the text: neither layout nor comments decide a run.
        digest.update(ast.dump(ast.parse(file.read_text(encoding="utf-8"))).encode())
    for package in packages:
        digest.update(f"{package} {_installed(package)}\n".encode())
    for other in others:
        digest.update(f"{other}\n".encode())
    return digest.hexdigest()[:16]


def chosen(field: str, listed: str, known: Sequence[str]) -> list[str]:
    """The comma-separated names, each once, in the order of `known`.

    Raises:
        InputError: a name that is not known.
    """
    names = set(listed.split(","))
    for name in sorted(names - set(known)):
        raise InputError(field, name, f"some of {','.join(known)}")
    return [name for name in known if name in names]


def torch_is_installed() -> bool:
    """Whether GPSampler can run: it needs PyTorch, which this project does not."""
    return importlib.util.find_spec("torch") is not None


def runnable(arms: list[str]) -> list[str]:
    """The arms without GPSampler, with a line about it, where there is no PyTorch.

    Raises:
        InputError: nothing is left.
    """
    if "gp" not in arms or torch_is_installed():
        return arms
    print("GPSampler is left out: it needs PyTorch (pip install torch)", file=sys.stderr)
    if arms == ["gp"]:
        raise InputError("arms", "gp", "PyTorch installed, or another arm")
    return [arm for arm in arms if arm != "gp"]


def _read(file: Path) -> dict[str, Any]:
    parsed: dict[str, Any] = json.loads(file.read_text())
    return parsed


def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"

"""The walker's kernels, compiled once for all processes of a parallel run.

Taichi writes what it has compiled when a process ends. So on a fresh machine each worker, and each
command that a test starts, would compile the same kernel anew, half a minute at a time.
"""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from storage.pool import cores
from taichi_nmm.kernel_cache import CACHE_VARIABLE

ROOT = Path(__file__).resolve().parent.parent
SIMULATE = (
    "from taichi_nmm import PUBLISHED_GAINS, Settings, simulate; "
    "simulate(PUBLISHED_GAINS, duration_s=0.1, settings="
)
CODE = [
    f"{SIMULATE}Settings({settings}))"
    for settings in (
        "arch='cpu'",
        "arch='cpu', threads=1",
        "arch='cpu', precision='float64'",
        "arch='cpu', engine='mujoco'",
        "arch='cpu', engine='mujoco', threads=1",
    )
]


def compile_kernels() -> None:
    """Compile what most tests simulate with, unless something is there already."""
    folder = Path(os.environ[CACHE_VARIABLE])
    if folder.is_dir() and any(folder.iterdir()):
        return
    with ThreadPoolExecutor(cores()) as threads:
        for _ in threads.map(compile_kernel, CODE):
            pass


def compile_kernel(code: str) -> None:
    """In a process of its own, which writes it to the cache; a test will say what is wrong."""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=False)

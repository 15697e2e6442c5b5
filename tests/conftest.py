"""Shared by all tests: Taichi's cache of compiled kernels lives in the project, not in the home."""

import os
from pathlib import Path

CACHE = Path(__file__).resolve().parent.parent / ".pytest_cache" / "taichi"
os.environ.setdefault("TI_OFFLINE_CACHE_FILE_PATH", str(CACHE))

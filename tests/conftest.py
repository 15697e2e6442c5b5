"""Shared by all tests: what they need of the machine, whoever starts them.

Taichi's cache of compiled kernels lives in the project, not in the home. A shell ignores Ctrl-C for
what it starts in the background, and children inherit that: commands under test must hear it.
"""

import os
import signal
from pathlib import Path

CACHE = Path(__file__).resolve().parent.parent / ".pytest_cache" / "taichi"
os.environ.setdefault("TI_OFFLINE_CACHE_FILE_PATH", str(CACHE))
signal.signal(signal.SIGINT, signal.default_int_handler)

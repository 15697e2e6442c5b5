"""Where Taichi keeps compiled kernels: checked before it starts, since it checks nothing itself.

Without a home it aborts the process, and a folder that cannot be written costs a compilation of
half a minute at every start, with no word.
"""

import os
import tempfile
from pathlib import Path

from taichi_nmm.errors import InputError

CACHE_VARIABLE = "TI_OFFLINE_CACHE_FILE_PATH"  # Taichi's own
DEFAULT_CACHE = Path(".cache") / "taichi"  # of the home


def require_kernel_cache() -> None:
    """Refuse a machine on which Taichi can keep no kernels; no Taichi is loaded.

    A cache of another version needs no check: Taichi compiles anew what it does not know.

    Raises:
        InputError: no home, or no folder that can be written.
    """
    home = os.environ.get("HOME")
    if not home:
        allowed = "a folder of yours: Taichi needs it, and keeps compiled kernels there"
        raise InputError("HOME", home or "unset", allowed)
    named = os.environ.get(CACHE_VARIABLE)
    folder = Path(named) if named else Path(home) / DEFAULT_CACHE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        allowed = f"a folder that can be written, for compiled kernels ({error.strerror})"
        raise InputError(CACHE_VARIABLE if named else "HOME", str(folder), allowed) from None

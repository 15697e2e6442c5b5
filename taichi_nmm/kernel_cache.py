"""The environment that Taichi runs in: a place for compiled kernels, and none of its variables.

Taichi checks neither. Without a home it aborts the process, and where the folder cannot
be written it compiles for half a minute at every start. TI_ARCH and its like override
the arguments of `ti.init`, or abort the process where they are misspelt. Python 3.14
has no Taichi but its fork, Quadrants, which does the same under other names.
"""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from storage.inputs.errors import InputError

# pyproject.toml has the same rule.
COMPILER = "quadrants" if sys.version_info >= (3, 14) else "taichi"
PREFIX = {"taichi": "TI_", "quadrants": "QD_"}[COMPILER]  # of its variables
CACHE_VARIABLE = f"{PREFIX}OFFLINE_CACHE_FILE_PATH"  # the compiler's own
DEFAULT_CACHE = Path(".cache") / COMPILER  # of the home
SETTLED = {
    "LC_ALL": "C.UTF-8",  # Taichi decodes its own path: an unknown locale is an exception
    f"{PREFIX}ENABLE_PYBUF": "0",  # else it prints in a notebook, and at every launch
}


def require_kernel_cache() -> None:
    """Refuse a machine on which Taichi can keep no kernels, before Taichi is loaded.

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
        allowed = (
            f"a folder that can be written, for compiled kernels ({error.strerror})"
        )
        raise InputError(
            CACHE_VARIABLE if named else "HOME", str(folder), allowed
        ) from None


@contextmanager
def settled_environment() -> Iterator[None]:
    """Hide all variables of Taichi but the cache's, and set a locale that Python has."""
    hidden = [
        name
        for name in os.environ
        if name.startswith(PREFIX) and name != CACHE_VARIABLE
    ]
    kept = {name: os.environ.pop(name, None) for name in {*hidden, *SETTLED}}
    os.environ.update(SETTLED)
    try:
        yield
    finally:
        for name in SETTLED:
            del os.environ[name]
        os.environ.update(
            {name: value for name, value in kept.items() if value is not None}
        )

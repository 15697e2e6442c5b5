"""What Taichi reads of the environment: where its compiled kernels are, and nothing else.

Left to itself, TI_ARCH and its like override what `ti.init` is given, or abort the process where
they are misspelt; and a locale that Python does not know is an exception at its import.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from taichi_nmm.kernel_cache import CACHE_VARIABLE

PREFIX = "TI_"
SETTLED = {
    "LC_ALL": "C.UTF-8",  # it decodes the path of its own folder
    "TI_ENABLE_PYBUF": "0",  # in a notebook it would say so, and ask every launch what it printed
}


@contextmanager
def settled_environment() -> Iterator[None]:
    """For as long, Taichi finds no variable of its own but the cache's, and a locale it knows."""
    hidden = [name for name in os.environ if name.startswith(PREFIX) and name != CACHE_VARIABLE]
    kept = {name: os.environ.pop(name, None) for name in {*hidden, *SETTLED}}
    os.environ.update(SETTLED)
    try:
        yield
    finally:
        for name in SETTLED:
            del os.environ[name]
        os.environ.update({name: value for name, value in kept.items() if value is not None})

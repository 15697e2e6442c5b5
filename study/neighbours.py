"""The packages installed beside this one: a file of a user may hide them.

`study` and `storage` are common names: where the working directory comes first on
Python's path, a `study.py` in it is imported in place of the package, and the error
that follows explains nothing. So this file imports the standard library alone.
"""

from importlib.util import find_spec
from pathlib import Path

BESIDE = Path(__file__).resolve().parents[1]


def require_neighbours(*names: str) -> None:
    """Check that these packages are those beside this one; none of them is imported.

    Raises:
        ImportError: a file or folder of the same name comes first on Python's path.
    """
    for name in names:
        spec = find_spec(name)
        if spec is None:
            continue
        places = [spec.origin, *(spec.submodule_search_locations or ())]
        found = next(Path(place).resolve() for place in places if place)
        if found != BESIDE / name / "__init__.py":
            said = f"{name}: {str(found)!r} cannot be used; allowed: another name, or"
            raise ImportError(
                f"{said} working directory: it hides {name} of taichi-nmm"
            )

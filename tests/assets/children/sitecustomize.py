"""What processes do first that tests start: they do without pandas.

PyArrow loads it where it is installed, which takes half a second of each process. Our
commands need it in `ribs` alone, and users who install them have none.
"""

import sys


class NoPandas:
    """Finds no pandas, but for `ribs`."""

    @staticmethod
    def find_spec(name: str, *_: object) -> None:
        if name == "pandas" and "ribs" not in sys.modules:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, NoPandas())

"""What processes do first that tests start: they do without pandas.

PyArrow loads it where it is installed, which takes half a second of each process. Our
commands need it in `ribs` alone, and users who install them have none.
"""

import sys
from importlib.machinery import ModuleSpec


class NoPandas:
    """Finds pandas, and does not load it, but for `ribs`."""

    @classmethod
    def find_spec(cls, name: str, *_: object) -> ModuleSpec | None:
        if name != "pandas" or "ribs" in sys.modules:
            return None
        return ModuleSpec(name, cls)

    @staticmethod
    def create_module(spec: ModuleSpec) -> None:
        raise ModuleNotFoundError(f"No module named {spec.name!r}", name=spec.name)

    @staticmethod
    def exec_module(_: object) -> None:
        """Never."""


sys.meta_path.insert(0, NoPandas)

"""Which problems there are. Names only: the packages that a problem needs are loaded with it."""

from importlib import import_module

from study.benchmarks.outside.definition import Definition
from taichi_nmm.errors import InputError

TUNING = ("digits-network", "transport-solver", "cluster-evolution")
REPORTED = ("tumour-boosting", "cart-pole", "stiff-reactions")
PROBLEMS = (*TUNING, *REPORTED)


def require_known(name: str) -> None:
    """Refuse a name that no problem has.

    Raises:
        InputError: listing those that there are.
    """
    if name not in PROBLEMS:
        raise InputError("problem", name, f"one of {', '.join(PROBLEMS)}")


def definition(name: str) -> Definition:
    """The problem as its own file defines it.

    Raises:
        InputError: no such problem, or a package that it needs is missing.
    """
    require_known(name)
    try:
        module = import_module(f"study.benchmarks.outside.{name.replace('-', '_')}")
    except ModuleNotFoundError as error:
        raise InputError("problem", name, f"{error.name} installed, or another problem") from None
    found: Definition = module.DEFINITION
    return found

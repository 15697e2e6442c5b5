"""The walker interpreted by NumPy: the simulator's own modules, with NumPy in Taichi's place.

The leaf physics has no branch on a value, so it runs as it stands on arrays of walkers: a lane
index becomes the index array of all walkers. That checks the compiler, not the equations.
"""

import builtins
import importlib
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from taichi_nmm import kernel

INTERPRETED = (
    "elementary", "kinematics", "muscle_table", "attachments", "muscle", "dynamics", "contact",
    "joint_stops", "delays", "reflexes", "swing", "gait", "walker",
)  # fmt: skip


class AllLanes:
    """Stands for the lane count: `range` of it yields one index, that of all walkers."""

    def __init__(self, count: int) -> None:
        self.index = np.arange(count)


def lane_range(*arguments: Any) -> Any:
    """`range`, but for `AllLanes`."""
    if isinstance(arguments[0], AllLanes):
        return [arguments[0].index]
    return builtins.range(*arguments)


def _cast(value: Any, dtype: Any) -> Any:
    return np.asarray(value).astype(dtype)


def _static(*values: Any) -> Any:
    return values[0] if len(values) == 1 else values


NUMPY_TAICHI = SimpleNamespace(
    func=lambda function: function,
    static=_static,
    select=np.where,
    max=np.maximum,
    min=np.minimum,
    floor=np.floor,
    sqrt=np.sqrt,
    cast=_cast,
    raw_mod=np.fmod,
    bit_cast=lambda value, dtype: value.view(dtype),
    Vector=list,
    i32=np.int32,
    i64=np.int64,
    f32=np.float32,
    f64=np.float64,
)


def interpreted_walker() -> Any:
    """The module `walker`, and all it imports, over NumPy in float64.

    The real modules are put back before returning.
    """
    shim: Any = ModuleType("taichi_nmm.kernel.backend")
    shim.ti, shim.Rows, shim.is_double = NUMPY_TAICHI, Any, lambda: True
    replaced = ("backend", *INTERPRETED)
    real = {name: sys.modules.pop(f"{kernel.__name__}.{name}", None) for name in replaced}
    for name in replaced:
        vars(kernel).pop(name, None)
    sys.modules[shim.__name__] = kernel.backend = shim
    try:
        walker: Any = importlib.import_module("taichi_nmm.kernel.walker")
        walker.range = lane_range
        # Without the early exit: a settled pass repeats itself, bit for bit.
        walker.settled = lambda lanes, work: False
        return walker
    finally:
        for name, module in real.items():
            sys.modules.pop(f"{kernel.__name__}.{name}", None)
            vars(kernel).pop(name, None)
            if module is not None:
                sys.modules[f"{kernel.__name__}.{name}"] = module
                setattr(kernel, name, module)

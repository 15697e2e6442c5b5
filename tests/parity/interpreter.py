"""The walker interpreted by NumPy: the simulator's own modules, with NumPy in Taichi's place.

The leaf physics has no branch on a value, so it runs as it stands on arrays of walkers:
a lane index becomes the index array of all walkers. That checks the compiler, not the
equations.
"""

import builtins
import importlib
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from taichi_nmm import kernel

INTERPRETED = (
    "elementary",
    "kinematics",
    "muscle_table",
    "joints",
    "muscle",
    "dynamics",
    "contact",
    "nerves",
    "reflexes",
    "swing",
    "gait",
    "device",
    "walker",
    "entry_points",
    "carried",
    "actuation",
)


class AllLanes:
    """Stands for the lane count: `range` of it yields one index, that of all walkers."""

    def __init__(self, count):
        self.index = np.arange(count)


def lane_range(*arguments):
    """`range`, but for `AllLanes`."""
    if isinstance(arguments[0], AllLanes):
        return [arguments[0].index]
    return builtins.range(*arguments)


NUMPY_TAICHI = SimpleNamespace(
    func=lambda function: function,
    kernel=lambda function: function,
    static=lambda *values: values[0] if len(values) == 1 else values,
    select=np.where,
    max=np.maximum,
    min=np.minimum,
    floor=np.floor,
    sqrt=np.sqrt,
    cast=lambda value, dtype: np.asarray(value).astype(dtype),
    raw_mod=np.fmod,
    bit_cast=lambda value, dtype: value.view(dtype),
    Vector=list,
    i32=np.int32,
    u32=np.uint32,
    i64=np.int64,
    f32=np.float32,
    f64=np.float64,
)


def interpreted_walker():
    """The module `walker`, and all it imports, over NumPy in float64."""
    (walker,) = interpreted("walker")
    return walker


def interpreted(*names, double=True):
    """Modules of the kernel, and all they import, over NumPy in float64, or in float32.

    Sums and products are of the arrays' own type. The real modules are put back before
    returning.
    """
    shim = ModuleType("taichi_nmm.kernel.backend")
    shim.ti = NUMPY_TAICHI
    shim.Rows = shim.Static = shim.Array = Any
    shim.is_double = lambda: double
    # Used in kernels, which are not interpreted.
    shim.local_rows = shim.named_rows = None
    replaced = ("backend", *INTERPRETED)
    real = {
        name: sys.modules.pop(f"{kernel.__name__}.{name}", None) for name in replaced
    }
    for name in replaced:
        vars(kernel).pop(name, None)
    sys.modules[shim.__name__] = kernel.backend = shim
    try:
        prefix = kernel.__name__
        modules = {
            name: importlib.import_module(f"{prefix}.{name}") for name in INTERPRETED
        }
        for name in ("walker", "carried", "actuation"):
            vars(modules[name])["range"] = lane_range
        # All phases for all lanes, and no early exit: a settled pass repeats itself,
        # bit for bit.
        vars(modules["walker"])["highest"] = lambda row, lanes: 1.0
        vars(modules["walker"])["nerves_vary"] = lambda lanes, const: True
        return tuple(modules[name] for name in names)
    finally:
        for name, module in real.items():
            sys.modules.pop(f"{kernel.__name__}.{name}", None)
            vars(kernel).pop(name, None)
            if module is not None:
                sys.modules[f"{kernel.__name__}.{name}"] = module
                setattr(kernel, name, module)

"""The one place that initialises Taichi; every other module takes `ti` from here.

How a CPU is kept busy: the state of LANES walkers lies side by side in small local arrays, and each
phase of the step is an innermost loop over them. LLVM's loop vectoriser turns that loop into SIMD
instructions, as long as its body has no branch, calls no library function and touches no memory but
local arrays (a field access reloads a pointer in every turn, which halves the vector width). So the
physics is plain scalar code; on a GPU the same code runs with one walker a thread, and a pack holds
the walkers of a warp, whose threads read side by side.
"""

import contextlib
import io
import os
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from taichi_nmm.errors import InputError
from taichi_nmm.kernel import compiler, registers
from taichi_nmm.kernel.compiler import local_rows, ti
from taichi_nmm.kernel_cache import COMPILER, settled_environment
from taichi_nmm.settings import Settings

__all__ = [
    "Array", "BoundKernel", "Rows", "is_double", "lanes", "lanes_a_turn", "launch", "local_rows",
    "metadata", "real_dtype", "start", "ti",
]  # fmt: skip

LANES_CPU = 8  # where the registers' width is unknown
LANES_GPU = 32  # a warp

# Measured, not assumed: with Taichi's control-flow-graph pass a loop nest holding a comparison lost
# its stores without an error. Strict floating point keeps NaN checks honest and results portable.
CFG_OPTIMIZATION = False
FAST_MATH = False

# Taichi's own simplifications take most of a compilation, since their time grows with the square of
# a kernel's size. LLVM, which follows, finds the same in seconds (docs/speed.md).
TAICHI_OPTIMIZATION = False

if TYPE_CHECKING:
    Rows: TypeAlias = Any
    Array: TypeAlias = Any
else:
    Rows = ti.template()  # a local array [row, lane], passed by reference
    Array = ti.types.ndarray()  # a NumPy array, passed to a kernel without a copy on a CPU

_running: Settings | None = None
_arch = "cpu"
_lanes = LANES_CPU
_compiled: set[str] = set()
_process = 0  # number of the process that initialised Taichi
_session = 0  # how often Taichi was initialised; kernels bound in an earlier session are gone


def start(settings: Settings) -> None:
    """Initialise Taichi for these settings; does nothing when it already runs so.

    Kernels hold no fields, so starting again with another precision loses nothing.

    Raises:
        InputError: the architecture asked for is not on this machine; or this process was forked
            from one that had started Taichi.
    """
    global _running, _arch, _lanes, _session, _process
    if _process not in (0, os.getpid()):  # a fork has none of Taichi's threads: it would hang
        allowed = (
            "one started by multiprocessing.get_context('spawn'), not forked after a simulation"
        )
        raise InputError("process", os.getpid(), allowed)
    if _running and _engine(settings) == _engine(_running):
        return
    _require_main_thread()
    _compiled.clear()
    _session += 1
    for arch in ("cuda", "cpu") if settings.arch == "auto" else (settings.arch,):
        if _initialise(arch, settings):
            _lanes = _settle_lanes(arch, settings.wide_registers)
            _running = settings
            _arch = arch
            _process = os.getpid()
            return
    raise InputError("simulation.arch", settings.arch, "an architecture of this machine (cpu is)")


def launch(kernel: Callable[..., None], *arguments: Any) -> None:
    """Run a kernel, compiling it first where it is new.

    Raises:
        InputError: the kernel is new and this is not the main thread (compiling there aborts the
            process), or a GPU's driver cannot take it.
    """
    if kernel.__name__ in _compiled:
        kernel(*arguments)
        return
    _require_main_thread()
    try:
        with registers.without_remarks():
            kernel(*arguments)
    except RuntimeError as error:
        if _arch == "cpu":  # there is no driver: the error is ours
            raise
        # A driver refuses a kernel at the first launch only, in several lines.
        allowed = f"a device that runs the kernel ({' '.join(str(error).split())})"
        raise InputError("simulation.arch", _arch, allowed) from error
    _compiled.add(kernel.__name__)


class BoundKernel:
    """A kernel whose arrays stay the same from launch to launch: only whole numbers change.

    Taichi looks at every argument of every launch, which takes longer than a control tick of some
    walkers. Here that happens once; the arrays must stay contiguous, where they are. On a GPU it
    happens in every launch, which would leave the GPU's own addresses behind.
    """

    def __init__(self, kernel: Callable[..., None], *arguments: Any) -> None:
        """Bind a kernel, compiling it where it is new; nothing is launched.

        Raises:
            InputError: as `launch`.
        """
        self._kernel, self._arguments = kernel, arguments  # the arrays must outlive the launches
        self._bind()

    def launch(self, **numbers: int) -> None:
        """Run the kernel with these whole numbers in place of those it was bound with."""
        if self._session != _session:  # Taichi was started again, and has forgotten the kernel
            self._bind()
        if _arch != "cpu":
            names = [argument.name for argument in compiler.parameters(self._primal)]
            given = dict(zip(names, self._arguments, strict=True)) | numbers
            launch(self._kernel, *given.values())
            return
        for name, value in numbers.items():
            self._context.set_arg_int(self._slots[name], value)
        self._program.launch_kernel(self._compiled, self._context)

    def _bind(self) -> None:
        if self._kernel.__name__ not in _compiled:
            _require_main_thread()
        self._session = _session
        self._primal = self._kernel._primal  # type: ignore[attr-defined]
        if _arch != "cpu":
            return
        function = compiler.specialised(self._primal, self._arguments)
        self._program = ti.lang.impl.get_runtime().prog
        self._context = function.make_launch_context()
        self._slots: dict[str, Any] = {}
        for argument, value in zip(compiler.parameters(self._primal), self._arguments, strict=True):
            if argument.annotation is Rows:
                continue
            slot = self._slots[argument.name] = compiler.slot(len(self._slots))
            if isinstance(value, np.ndarray):
                assert value.flags.c_contiguous
                self._context.set_arg_external_array_with_shape(
                    slot, int(value.ctypes.data), value.nbytes, value.shape, 0
                )
            elif isinstance(value, int):
                self._context.set_arg_int(slot, value)
            else:
                self._context.set_arg_float(slot, float(value))
        with registers.without_remarks():
            self._compiled = compiler.compiled(function)
        _compiled.add(self._kernel.__name__)


def _require_main_thread() -> None:
    if threading.current_thread() is not threading.main_thread():
        raise InputError(
            "thread",
            threading.current_thread().name,
            "the main thread, for a process's first simulation; simulate once before starting "
            "threads such as study.optimize(n_jobs=2)",
        )


def lanes() -> int:
    """Walkers side by side in a pack on the machine that runs."""
    return _lanes


def lanes_a_turn() -> int:
    """How many lanes of a pack a turn of the kernels' loop takes: all; on a GPU one."""
    return _lanes if _arch == "cpu" else 1


def is_double() -> bool:
    """Whether the kernels being compiled compute in float64."""
    return _running is not None and _running.precision == "float64"


def real_dtype() -> type[np.floating[Any]]:
    """NumPy's type for the kernels' numbers."""
    return np.float64 if is_double() else np.float32


def metadata() -> dict[str, Any]:
    """Engine, version, machine and numerics of a result."""
    return {
        "engine": COMPILER,
        "engine_version": compiler.VERSION,
        "arch": _arch,
        "precision": _running.precision if _running else "",
        "fast_math": FAST_MATH,
    }


def _engine(settings: Settings) -> tuple[Any, ...]:
    """The settings that Taichi is initialised for."""
    return settings.precision, settings.arch, settings.threads, settings.wide_registers


def _settle_lanes(arch: str, wide: bool) -> int:
    """How many walkers a pack has; kernels compiled from now on are vectorised by this number."""
    on_cpu = arch == "cpu"
    width = registers.width() if on_cpu and wide else 0
    told = compiler.KNOWS_WIDTH or registers.tell_vectoriser(
        width, compiler.core.__file__, ti.__version__
    )
    return (told and width) or (LANES_CPU if on_cpu else LANES_GPU)


def _initialise(arch: str, settings: Settings) -> bool:
    """Start Taichi on `arch` and see that it computes there; False where the machine lacks it."""
    ti.set_logging_level(ti.ERROR)  # Taichi warns about every driver that is not there
    if arch == "cuda" and not compiler.core.with_cuda():
        return False
    threads = {} if settings.threads is None else {"cpu_max_num_threads": settings.threads}
    try:
        with contextlib.redirect_stdout(io.StringIO()), settled_environment():
            ti.init(
                arch=getattr(ti, arch),
                enable_fallback=False,
                default_fp=ti.f64 if settings.precision == "float64" else ti.f32,
                default_ip=ti.i32,
                cfg_optimization=CFG_OPTIMIZATION,
                advanced_optimization=TAICHI_OPTIMIZATION,
                fast_math=FAST_MATH,
                offline_cache=True,
                log_level=ti.ERROR,
                **compiler.WHOLE_LOOPS,
                **threads,
            )
        values = np.ones(4, dtype=np.float32)
        if arch != "cpu":  # stores of a driver without a device do not arrive
            _double(values)
        return arch == "cpu" or bool(np.all(values == 2.0))
    except RuntimeError:
        return False


@ti.kernel
def _double(values: Array):
    for i in range(values.shape[0]):
        values[i] = 2.0 * values[i]

"""The one place that initialises Taichi; every other module takes `ti` from here.

How a CPU is kept busy: the state of LANES walkers lies side by side in small local
arrays, and each phase of the step is an innermost loop over them. LLVM's loop
vectoriser turns that loop into SIMD instructions, as long as its body has no branch,
calls no library function and touches no memory but local arrays (a field access reloads
a pointer in every turn, which halves the vector width). So the physics is plain scalar
code; on a GPU the same code runs with one walker a thread (`queue`).
"""

import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from storage.inputs.errors import InputError
from taichi_nmm.kernel import compiler, program, registers
from taichi_nmm.kernel.compiler import local_rows, named_rows, ti
from taichi_nmm.kernel_cache import COMPILER
from taichi_nmm.settings import Settings, may_have_gpu

__all__ = [
    "Array",
    "BoundKernel",
    "Rows",
    "Static",
    "is_double",
    "lanes",
    "launch",
    "local_rows",
    "metadata",
    "named_rows",
    "real_dtype",
    "start",
    "ti",
]

LANES_CPU = 8  # where the registers' width is unknown
FIRST_START = (
    "the GPU's kernels compile for half a minute, unless an earlier process kept them"
)
LOG = logging.getLogger(__name__)
DEVICE_TYPES = {"float32": "f32", "float64": "f64", "int32": "i32"}

if TYPE_CHECKING:
    Rows: TypeAlias = Any
    Static: TypeAlias = Any
    Array: TypeAlias = Any
else:
    Rows = ti.template()  # a local array [row, lane], or some rows of one, by reference
    Static = ti.template()  # known when the kernel is compiled
    # A NumPy array, passed to a kernel without a copy on a CPU.
    Array = ti.types.ndarray()

_running: Settings | None = None
_arch = "cpu"
_automatic = "auto"  # what the architecture "auto" has turned out to be
_lanes = LANES_CPU
_compiled: set[str] = set()
_process = 0  # number of the process that runs Taichi
_program: Any = None  # the compiler's, in which our kernels are compiled
_is_ours = False  # whether we have begun it
_options: dict[str, Any] = {}  # by which they are compiled
_width = 0  # numbers of a register, by which they are vectorised; 0: LLVM chooses
# How often kernels were forgotten: those bound in an earlier session are gone.
_session = 0


def start(settings: Settings) -> None:
    """Have Taichi ready for these settings; does nothing when it already is.

    Kernels hold no fields, so compiling them again in another precision loses nothing.
    A program of the compiler that a script has begun, or has fields in, stays: our
    kernels move in.

    Raises:
        InputError: the architecture asked for is not on this machine, or not the one of
            the script's program; or this process was forked from one that had started
            Taichi.
    """
    global _running, _process, _session, _automatic
    if _process not in (0, os.getpid()):
        raise _forked()
    found = program.living()
    is_same = found is not None and found is _program
    if is_same and _running is not None and _engine(settings) == _engine(_running):
        return
    if found is not None and not is_same and not program.has_threads(found):
        raise _forked()
    _require_main_thread()
    _running = None  # until this has worked
    _find_program(settings, is_same)
    if settings.arch == "auto":
        _automatic = _arch
    _settle(settings)
    program.forget_kernels()
    _compiled.clear()
    _session += 1
    _running = replace(settings, arch=_arch)
    _process = os.getpid()


def _forked() -> InputError:
    """The error of a fork, which has none of Taichi's threads: it would hang."""
    allowed = "one started by multiprocessing.get_context('spawn'), not forked after a simulation"
    return InputError("process", os.getpid(), f"{allowed} or ti.init")


def _find_program(settings: Settings, is_same: bool) -> None:
    """Take the program that lives; begin one where there is none, or ours computes elsewhere.

    Raises:
        InputError: as of `start`.
    """
    global _program, _arch, _is_ours
    wanted = ("cuda", "cpu") if settings.arch == "auto" else (settings.arch,)
    found = program.living()
    _is_ours = found is None or (_is_ours and is_same)
    if found is not None and not (_is_ours and not program.is_shared(found)):
        arch = program.architecture(found)
        if arch not in wanted:
            allowed = f"{arch}, on which this script's own Taichi runs; or a process of its own"
            raise InputError("simulation.arch", settings.arch, allowed)
        _program, _arch = found, arch
        return
    for arch in wanted:
        found = program.living()  # none after a try that failed
        runs = found is not None and program.architecture(found) == arch
        if runs or (program.begin(arch) and _computes(arch)):
            _program, _arch = program.living(), arch
            return
    raise InputError(
        "simulation.arch", settings.arch, "an architecture of this machine (cpu is)"
    )


def _settle(settings: Settings) -> None:
    """By which options, and how many walkers in a pack, kernels are compiled from now on."""
    global _options, _width, _lanes
    on_cpu = _arch == "cpu"
    compiler.unrolls = not on_cpu
    _options = program.options(_program, settings.precision, settings.threads)
    width = registers.width() if on_cpu and settings.wide_registers else 0
    told = program.tell_vectoriser(width)
    program.tell_vectoriser(0)  # but while our kernels are compiled
    _width = width if told else 0
    _lanes = _width or LANES_CPU


@contextmanager
def _compiling() -> Iterator[None]:
    """Options, and standard error, as our kernels need them while they are compiled."""
    with registers.without_remarks(), program.in_force(_program, _options, _width):
        yield


def launch(kernel: Callable[..., None], *arguments: Any) -> None:
    """Run a kernel, compiling it first where it is new.

    Raises:
        InputError: the kernel is new and this is not the main thread (compiling there
            aborts the process), or a GPU's driver cannot take it.
    """
    if kernel.__name__ in _compiled:
        # The compiler looks for the kernel by its options.
        with program.in_force(_program, _options, _width):
            kernel(*arguments)
        return
    _require_main_thread()
    if compiler.unrolls and not _compiled:
        LOG.warning(FIRST_START)
    try:
        with _compiling():
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

    Taichi looks at every argument of every launch, which takes longer than a control
    tick of some walkers. Here that happens once; the arrays must stay contiguous, where
    they are. On a GPU it happens in every launch, which would leave the GPU's own
    addresses behind.
    """

    def __init__(self, kernel: Callable[..., None], *arguments: Any) -> None:
        """Bind a kernel, compiling it where it is new; nothing is launched.

        Raises:
            InputError: as `launch`.
        """
        self._kernel = kernel
        self._arguments = arguments  # the arrays must outlive the launches
        self._bind()

    def launch(self, **numbers: int) -> None:
        """Run the kernel with these whole numbers in place of those it was bound with."""
        if program.living() is not self._program:  # a script has called ti.init since
            assert _running is not None
            start(_running)
        # Taichi was started again, and has forgotten the kernel.
        if self._session != _session:
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
        self._program = program.living()
        if _arch != "cpu":
            return
        with _compiling():
            function = compiler.specialised(self._primal, self._arguments)
            self._compiled = compiler.compiled(function)
        self._context = function.make_launch_context()
        self._slots: dict[str, Any] = {}
        for argument, value in zip(
            compiler.parameters(self._primal), self._arguments, strict=True
        ):
            if argument.annotation is Static:
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
        _compiled.add(self._kernel.__name__)


def _require_main_thread() -> None:
    if threading.current_thread() is not threading.main_thread():
        raise InputError(
            "thread",
            threading.current_thread().name,
            "the main thread, for a process's first simulation; simulate once before starting "
            "threads such as study.optimize(n_jobs=2)",
        )


def on_device(array: NDArray[Any], copy: Callable[..., None]) -> Any:
    """An array [row, column] where the kernels compute: itself on a processor.

    Args:
        array: of float32, float64 or int32.
        copy: the kernel that copies its first argument to its second.
    """
    if _arch == "cpu":
        return array
    found = empty_on_device(array.shape, array.dtype)
    launch(copy, np.ascontiguousarray(array), found)
    return found


def empty_on_device(shape: tuple[int, ...], dtype: Any) -> Any:
    """An array without values where the kernels compute."""
    if _arch == "cpu":
        return np.empty(shape, dtype)
    return ti.ndarray(getattr(ti, DEVICE_TYPES[np.dtype(dtype).name]), shape)


def on_host(array: Any, copy: Callable[..., None]) -> NDArray[Any]:
    """The values of such an array."""
    if isinstance(array, np.ndarray):
        return array
    found = np.empty(array.shape, compiler.to_numpy_type(array.dtype))
    launch(copy, array, found)
    return found


def is_gpu() -> bool:
    """Whether the kernels compute on another device than the processor."""
    return _arch != "cpu"


def lanes() -> int:
    """Walkers side by side in a pack on the machine that runs."""
    return _lanes


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
        "fast_math": program.FAST_MATH,
    }


def _engine(settings: Settings) -> tuple[Any, ...]:
    """The settings that Taichi is initialised for."""
    arch = _automatic if settings.arch == "auto" else settings.arch
    if arch == "auto" and not may_have_gpu():
        arch = "cpu"  # so that few walkers, and then many, share one program
    return settings.precision, arch, settings.threads, settings.wide_registers


def _computes(arch: str) -> bool:
    """Whether a program that was begun stores numbers: without a device none arrive."""
    if arch == "cpu":
        return True
    values = np.ones(4, dtype=np.float32)
    try:
        _double(values)
    except RuntimeError:
        return False
    return bool(np.all(values == 2.0))


@ti.kernel
def _double(values: Array):
    for i in range(values.shape[0]):
        values[i] = 2.0 * values[i]

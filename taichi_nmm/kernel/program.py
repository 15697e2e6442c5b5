"""The program of the compiler in this process: one that we began, or one of somebody else's.

A process has one program at a time, and `ti.init` ends the one before, with all its
fields. A script may use Taichi itself: it may have begun a program before our first
simulation, or begin another one after it. So we begin a program only where none lives.
In any other our kernels are compiled with our options, and the script's come back at
once: our results keep their bits, and the script its fields.
"""

import contextlib
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from storage.inputs.errors import InputError
from taichi_nmm.kernel import compiler, registers
from taichi_nmm.kernel.compiler import core, impl, ti
from taichi_nmm.kernel_cache import settled_environment

# Measured, not assumed: with Taichi's control-flow-graph pass a loop nest holding a
# comparison lost its stores without an error. Strict floating point keeps NaN checks
# honest and results portable.
CFG_OPTIMIZATION = False
FAST_MATH = False

# Taichi's own simplifications take most of a compilation, since their time grows with
# the square of a kernel's size. LLVM, which follows, finds the same in seconds
# (docs/speed.md).
TAICHI_OPTIMIZATION = False

OPTIONS: dict[str, Any] = {
    "cfg_optimization": CFG_OPTIMIZATION,
    "advanced_optimization": TAICHI_OPTIMIZATION,
    "fast_math": FAST_MATH,
    **compiler.WHOLE_LOOPS,
}

# What a program is, and what it keeps or prints: no bit of a kernel depends on these.
# The words are beginnings of names, since the two compilers differ in a few.
OF_THE_PROGRAM = (
    "arch",
    "cpu_max_num_threads",
    "debug_dump",
    "device_memory",
    "kernel_profiler",
    "max_block_dim",  # of the device, as is
    "num_compile",
    "offline_cache",
    "print_",
    "random_seed",
    "saturating_grid_dim",  # the number of blocks that fill it
    "timeline",
    "verbose",
    "vk_",
)
PROCESSORS = ("x64", "arm64")  # names of an architecture that is a processor's

# Of the runtime in Python, beside the program's configuration: the values that
# `ti.init` sets.
RUNTIME_OPTIONS = {
    "short_circuit_operators": True,
    "print_full_traceback": False,
    "unrolling_limit": 32,
}


def living() -> Any:
    """The program that lives in this process, whoever began it; None: there is none."""
    runtime = impl.get_runtime()
    return runtime._prog if hasattr(runtime, "_prog") else runtime.prog


def architecture(program: Any) -> str:
    """What a program computes on: "cpu", "cuda", or another name of the compiler's."""
    name = str(core.arch_name(program.config().arch))
    return "cpu" if name in PROCESSORS else name


def has_threads(program: Any) -> bool:
    """Whether the threads of a program on the processor are there: a fork has none of them."""
    try:
        threads = len(os.listdir("/proc/self/task"))  # noqa: PTH208  (of names that may vanish)
    except OSError:  # another system than Linux
        return True
    return threads > int(program.config().cpu_max_num_threads)  # and the main thread


def is_shared(program: Any) -> bool:
    """Whether somebody else has fields in a program, or has compiled kernels in it: we have both.

    Our kernels take arrays of NumPy, and the program's only tree of fields is empty.
    """
    roots = [
        program.get_snode_root(tree) for tree in range(program.get_snode_tree_size())
    ]
    has_fields = bool(impl.get_runtime().global_vars) or any(
        root.get_num_ch() for root in roots
    )
    others = [kernel for kernel in impl.get_runtime().kernels if not _is_ours(kernel)]
    return has_fields or any(compiler.kernels_of(kernel) for kernel in others)


def begin(arch: str) -> bool:
    """Begin a program of our own, which ends any other; False where the machine lacks `arch`."""
    ti.set_logging_level(ti.ERROR)  # Taichi warns about every driver that is not there
    if arch == "cuda" and not core.with_cuda():
        return False
    try:
        with contextlib.redirect_stdout(io.StringIO()), settled_environment():
            ti.init(
                arch=getattr(ti, arch),
                enable_fallback=False,
                offline_cache=True,
                log_level=ti.ERROR,
                **OPTIONS,
            )
    except RuntimeError:
        return False
    return True


def forget_kernels() -> None:
    """Have our kernels compiled anew, at their next launch."""
    for kernel in filter(_is_ours, impl.get_runtime().kernels):
        kernel.reset()


def options(program: Any, precision: str, threads: int | None) -> dict[str, Any]:
    """All options that decide what code a kernel becomes.

    Args:
        program: whose threads are the most.
        precision: "float32" or "float64".
        threads: how many may work; None: all.
    """
    usual = core.CompileConfig()
    names = [name for name in dir(usual) if not name.startswith(("_", *OF_THE_PROGRAM))]
    most = int(program.config().cpu_max_num_threads)
    return {name: getattr(usual, name) for name in names} | {
        **OPTIONS,
        "default_fp": ti.f64 if precision == "float64" else ti.f32,
        "default_ip": ti.i32,
        "default_up": ti.u32,
        "cpu_max_num_threads": most if threads is None else min(threads, most),
    }


@contextmanager
def in_force(program: Any, ours: dict[str, Any], width: int) -> Iterator[None]:
    """Have a program compile by our options; afterwards it is as it was.

    Args:
        program: that lives.
        ours: of `options`.
        width: numbers of a register that LLVM is told of; 0: it chooses.

    Raises:
        InputError: the script has declared fields without a place.
    """
    runtime = impl.get_runtime()
    config = program.config()
    try:
        runtime.materialize()  # the script's fields, while its own options hold
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        allowed = f"all fields placed, before a simulation ({reason})"
        raise InputError("taichi", "this script's fields", allowed) from None
    types = {name: ours[name] for name in ("default_fp", "default_ip", "default_up")}
    kept = _replace(config, ours)
    kept_of_runtime = _replace(runtime, RUNTIME_OPTIONS | types)
    tell_vectoriser(width)
    try:
        yield
    finally:
        tell_vectoriser(0)
        _replace(runtime, kept_of_runtime)
        _replace(config, kept)


def tell_vectoriser(width: int) -> bool:
    """Have LLVM vectorise by so many numbers from now on, by its own choice for 0; whether it will.

    The setting is the process's: while nothing of ours is compiled, it is 0.
    """
    if compiler.KNOWS_WIDTH:
        return True
    return registers.tell_vectoriser(width, core.__file__, ti.__version__)


def _replace(owner: Any, values: dict[str, Any]) -> dict[str, Any]:
    """Set attributes, where they differ; what those were before."""
    before = {name: getattr(owner, name) for name in values}
    changed = {name: value for name, value in before.items() if value != values[name]}
    for name in changed:
        setattr(owner, name, values[name])
    return changed


def _is_ours(kernel: Any) -> bool:
    return bool(kernel.func.__module__.startswith("taichi_nmm."))

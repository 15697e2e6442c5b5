"""The compiler of the kernels and its insides: Taichi or, on Python 3.14, its fork, Quadrants.

This file alone imports them, as `ti`. Both run the same kernels to the same bits. What
is used of their insides stands here, side by side where they differ; pyproject.toml
pins their versions.
"""

import ast
import contextlib
import io
import os
import sys
import warnings
from functools import cache
from importlib import import_module
from typing import Any

from taichi_nmm.kernel.layout import Layout
from taichi_nmm.kernel_cache import COMPILER, settled_environment

# Standard output is the commands'.
os.environ.setdefault(f"ENABLE_{COMPILER.upper()}_HEADER_PRINT", "0")
with settled_environment(), contextlib.redirect_stdout(io.StringIO()):
    ti: Any = import_module(COMPILER)

VERSION = ".".join(str(part) for part in ti.__version__)
to_numpy_type = ti.lang.util.to_numpy_type
core, impl, kernel_impl = ti._lib.core, ti.lang.impl, ti.lang.kernel_impl


@ti.data_oriented  # the compiler leaves an object of such a class as it is
class LocalRows:
    """A local array [row, lane] of a kernel, which the compiler holds as one column.

    While Taichi compiles, it walks through the whole kernel for each constant that it
    folds. `array[3, lane]` has three such constants in two dimensions and one in a
    column: a kernel compiles in a quarter of the time, to the same bits.
    """

    def __init__(
        self, column: Any, lanes: int, first: Any = 0, offset: Any = 0
    ) -> None:
        self._column, self._lanes, self._first = column, lanes, first
        self._offset = offset  # of the first lane

    def __getitem__(self, index: Any) -> Any:
        """As NumPy: a slice of rows, one row (of which a lane is taken then), or a number."""
        if isinstance(index, slice):
            first = self._first + index.start
            return LocalRows(self._column, self._lanes, first, self._offset)
        if not isinstance(index, tuple):
            return LocalRow(self, index)
        row, lane = index
        builder = impl.get_runtime().compiling_callable.ast_builder()
        place = (self._first + row) * self._lanes + lane + self._offset
        return impl.subscript(builder, self._column, place)


@ti.data_oriented
class LocalRow:
    """One row of such an array, [lane]."""

    def __init__(self, rows: LocalRows, row: Any) -> None:
        self._rows, self._row = rows, row

    def __getitem__(self, lane: Any) -> Any:
        return self._rows[self._row, lane]


def local_rows(rows: int, lanes: int) -> Any:
    """Zeros [rows, lanes]; to be called in a kernel."""
    zeros = impl.expr_init(ti.lang.matrix.make_matrix([0.0] * (rows * lanes)))
    return LocalRows(zeros, lanes)


def named_rows(layout: Layout, lanes: int) -> Any:
    """The same with as many rows as a layout has, by its names."""
    return layout.of(local_rows(layout.count, lanes))


class SplitRows:
    """Rows of which the first lie in one place and the others in another."""

    _data_oriented = True  # as a `NamedRows`

    def __init__(self, rows: Any, others: Any, count: int) -> None:
        self._rows, self._others, self._count = rows, others, count

    def __getitem__(self, index: Any) -> Any:
        """As NumPy: a slice of rows or a row, in one of the places, or a number."""
        if isinstance(index, tuple):
            return self[index[0]][index[1]]
        start = index.start if isinstance(index, slice) else index
        if start < self._count:
            return self._rows[index]
        if isinstance(index, slice):
            return self._others[start - self._count : index.stop - self._count]
        return self._others[start - self._count]


def shared_table(rows: int, columns: int) -> Any:
    """An array [row, column] that on a GPU the threads of a block share."""
    if not unrolls:
        return local_rows(rows, columns)
    real = impl.get_runtime().default_fp
    return LocalRows(ti.simt.block.SharedArray((rows * columns,), real), columns)


def shared_rows(layout: Layout, first: int, turn: Any, turns: int) -> Any:
    """Named rows [row, 1], which on a GPU lie from `first` on in a block's shared memory.

    Each thread has its own: registers are few, and the nearest cache is shared memory
    too.

    Args:
        layout: of the rows.
        first: row of the layout.
        turn: number of the parallel loop's turn.
        turns: of a block.
    """
    if not unrolls:
        return named_rows(layout, 1)
    shared = shared_table(layout.count - first, turns)
    others = LocalRows(shared._column, turns, 0, turn % turns)
    return layout.of(SplitRows(local_rows(first, 1), others, first))


for function in (local_rows, named_rows, shared_table, shared_rows):  # no warning
    setattr(function, f"_is_{COMPILER}_function", False)


def _short_position(context: Any, node: Any) -> str:
    """Name a source line instead of drawing it, which takes half of a warm start."""
    line = node.lineno + context.lineno_offset
    return f'File "{context.file}", line {line}, in {context.func.func.__name__}:\n'


def _inside_class(level_of_class_stackframe: int) -> bool:
    """Whether a function is a method: none of ours is, and finding it out takes long."""
    level = level_of_class_stackframe
    if sys._getframe(level - 1).f_globals["__name__"].startswith("taichi_nmm."):
        return False
    return bool(_compilers_inside_class(level + 1))


_compilers_inside_class = kernel_impl._inside_class
kernel_impl._inside_class = _inside_class
transformer = ti.lang.ast.ast_transformer_utils

# Whether loops of a known length are written out while a kernel is compiled. A GPU keeps
# numbers in registers whose row is known then; a CPU would miss its nearest cache.
unrolls = False
LONGEST_UNROLLED = 200  # turns; the rows of the delay rings stay in memory anyway
statements = ti.lang.ast.ast_transformer


def _build_loop(ctx: Any, node: Any) -> Any:
    """A loop of a kernel, written out where that is wanted."""
    if not (unrolls and _is_known(ctx, node)):
        return _build_for(ctx, node)
    with ctx.loop_scope_guard(is_static=True), warnings.catch_warnings():
        # `range` is no function of Taichi.
        warnings.simplefilter("ignore", SyntaxWarning)
        return statements.ASTTransformer.build_static_for(ctx, node, False)


def _is_known(ctx: Any, node: Any) -> bool:
    """Whether a loop is over a `range` of numbers that are known, and runs to its end."""
    call = node.iter
    if not isinstance(call, ast.Call) or getattr(call.func, "id", "") != "range":
        return False
    if any(isinstance(each, ast.Break) for each in ast.walk(node)):
        return False
    ends = [statements.build_stmt(ctx, each) for each in call.args]
    if not all(isinstance(end, int) for end in ends):
        return False
    return len(range(*ends)) <= LONGEST_UNROLLED


_build_for = statements.ASTTransformer.build_For
statements.ASTTransformer.build_For = staticmethod(_build_loop)

# Here the two differ. A function is inlined at each of its calls, and a compiler would
# look for its source each time. Both cut a parallel loop into blocks of at least 512
# turns, and a turn of the kernels is a pack: 4,096 walkers and fewer would run on one
# thread. With WHOLE_LOOPS, options of `ti.init`, a turn is a task. KNOWS_WIDTH: whether
# LLVM knows the width of registers by itself.
if COMPILER == "taichi":
    KNOWS_WIDTH = False  # LLVM 15
    WHOLE_LOOPS = {"make_cpu_multithreading_loop": False}
    transformer.ASTTransformerContext.get_pos_info = _short_position
    kernel_impl.getsourcefile = cache(kernel_impl.getsourcefile)
    kernel_impl.getsourcelines = cache(kernel_impl.getsourcelines)
else:
    KNOWS_WIDTH = True  # LLVM 22
    WHOLE_LOOPS = {"cpu_work_scheduling": core.CPUWorkScheduling.FIXED_SIZE}
    transformer.ASTTransformerFuncContext._build_pos_info = _short_position
    modules: Any = map(
        import_module, ("quadrants.lang._func_base", "quadrants.lang.kernel")
    )
    for module in modules:
        module.get_source_info_and_src = cache(module.get_source_info_and_src)

    def _one_pass(primal: Any, arguments: Any, key: Any) -> set[str] | None:
        """Leave out the pass that looks for unused members of dataclasses: ours have none."""
        known: set[str] | None = _look_up(primal, arguments, key)
        if primal.func.__module__.startswith("taichi_nmm."):
            known = primal.used_py_dataclass_parameters_by_key_enforcing[key] = set()
        return known

    _look_up = kernel_impl.Kernel._try_load_fastcache
    kernel_impl.Kernel._try_load_fastcache = _one_pass


def parameters(primal: Any) -> Any:
    """The parameters of a kernel, each with a name and an annotation."""
    return primal.arguments if COMPILER == "taichi" else primal.arg_metas


def specialised(primal: Any, arguments: tuple[Any, ...]) -> Any:
    """The kernel for arguments of these types."""
    if COMPILER == "taichi":
        return primal.compiled_kernels[primal.ensure_compiled(*arguments)]
    primal.raise_on_templated_floats = False  # else unset before a launch
    return primal.materialized_kernels[primal.ensure_compiled(*arguments)]


def kernels_of(primal: Any) -> Any:
    """What a kernel has become so far, by the types of its arguments."""
    return (
        primal.compiled_kernels if COMPILER == "taichi" else primal.materialized_kernels
    )


def slot(number: int) -> Any:
    """The place of an argument in a launch."""
    return (number,) if COMPILER == "taichi" else number


def compiled(function: Any) -> Any:
    """What a program launches."""
    program = impl.get_runtime().prog
    result = program.compile_kernel(
        program.config(), program.get_device_caps(), function
    )
    return result if COMPILER == "taichi" else result.compiled_kernel_data

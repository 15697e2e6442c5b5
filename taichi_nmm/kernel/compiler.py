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
from collections import Counter
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


PLACE, VARIABLE = 1, 2  # rank of a value: of numbers in an array, of a variable


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
        found = impl.subscript(builder, self._column, place)
        found.rank = PLACE
        return found


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
Builder = statements.ASTTransformer


def _is_unrolled(ctx: Any) -> bool:
    """Whether a function is one of ours, and is being compiled for a GPU."""
    return unrolls and _is_house(ctx.func)


def _is_house(function: Any) -> bool:
    """Whether a function or a kernel is one of ours."""
    return bool(function.func.__module__.startswith("taichi_nmm."))


def _build_loop(ctx: Any, node: Any) -> Any:
    """A loop of a kernel, written out where that is wanted."""
    if not (_is_unrolled(ctx) and _is_known(ctx, node)):
        return _build_for(ctx, node)
    with ctx.loop_scope_guard(is_static=True), warnings.catch_warnings():
        # `range` is no function of Taichi.
        warnings.simplefilter("ignore", SyntaxWarning)
        return Builder.build_static_for(ctx, node, False)


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


_build_for = Builder.build_For
Builder.build_For = staticmethod(_build_loop)

# While Taichi compiles, it walks through the whole kernel for each variable that it
# makes, and for each constant that it folds: for the GPU's kernel 27 of 34 s. So our
# functions make no copy there of what stays as it is. The GPU's code is the same.
NUMBERS = (int, float)
_stores: Any = {}  # by function: how often it sets a name
_most = VARIABLE  # rank of what needs a copy, in the function whose arguments are taken


def _build_function(ctx: Any, node: Any) -> Any:
    """A function. One that sets an argument copies all, one that gets rows may write a place."""
    global _most
    if ctx.func.func not in _stores:
        _stores[ctx.func.func] = Counter(
            each.id
            for each in ast.walk(node)
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)
        )
    stores = _stores[ctx.func.func]
    arguments = ctx.func.arguments
    _most = any(isinstance(each.annotation, ti.template) for each in arguments)
    if not _is_unrolled(ctx) or any(stores[each.name] for each in arguments):
        _most = VARIABLE
    return _build_def(ctx, node)


def _build_assignment(ctx: Any, node: Any) -> Any:
    """A value goes where it belongs at once, and a number that stays becomes no variable."""
    target = node.targets[0]
    is_new = all(
        isinstance(each, ast.Name) and not ctx.is_var_declared(each.id)
        for each in getattr(target, "elts", [])
    )
    if not (is_new and _is_unrolled(ctx)):
        return _build_assign(ctx, node)
    value = statements.build_stmt(ctx, node.value)
    stays = getattr(getattr(node.value, "func", None), "ptr", None) is impl.static
    if isinstance(value, NUMBERS):
        stays |= _stores[ctx.func.func][getattr(target, "id", "")] == 1
    return Builder.build_assign_unpack(ctx, target, value, stays)


def _variable(value: Any) -> Any:
    """A new variable of a kernel."""
    found = _init(value)
    if hasattr(found, "ptr"):
        found.rank = VARIABLE
    return found


def _argument(value: Any) -> Any:
    """What a function gets for a value."""
    rank = VARIABLE if isinstance(value, NUMBERS) else getattr(value, "rank", 0)
    return value if rank > _most else _init_argument(value)


_build_def = Builder.build_FunctionDef
_build_assign = Builder.build_Assign
_init, _init_argument = impl.expr_init, impl.expr_init_func

_trees: Any = {}  # of our functions, read once: their context is new at each call


def _tree_and_context(function: Any, **words: Any) -> Any:
    """The syntax tree of a function of ours, and where it is compiled; kernels change theirs."""
    if words.get("is_kernel", True) or not _is_house(function):
        return _read_function(function, **words)
    if function.func not in _trees:
        tree, context = _read_function(function, **words)
        place = {"src": context.src, "file": context.file}
        place["start_lineno"] = context.lineno_offset + 1
        _trees[function.func] = tree, place
    tree, place = _trees[function.func]
    context = transformer.ASTTransformerContext(
        is_kernel=False,
        func=function,
        global_vars=kernel_impl._get_global_vars(function.func),
        argument_data=words["args"],
        ast_builder=words["ast_builder"],
        **place,
    )
    return tree, context


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
    _read_function = kernel_impl._get_tree_and_ctx
    kernel_impl._get_tree_and_ctx = _tree_and_context
    Builder.build_FunctionDef = staticmethod(_build_function)
    Builder.build_Assign = staticmethod(_build_assignment)
    impl.expr_init, impl.expr_init_func = _variable, _argument
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

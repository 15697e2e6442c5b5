"""Our kernels as they are compiled for a GPU, without copies: here on a processor."""

import numpy as np
import pytest

from taichi_nmm import Settings
from taichi_nmm.kernel import backend, compiler
from taichi_nmm.kernel.backend import Array, Rows, local_rows, ti


@ti.func
def halved(x):
    x *= 0.5
    return x


@ti.func
def lift(rows: Rows, by):
    rows[0, 0], rows[1, 0] = rows[1, 0] + by, rows[0, 0]
    return by - rows[0, 0]


@ti.kernel
def compute(values: Array, found: Array):
    rows = local_rows(2, 1)
    changes = 1.0
    x = values[0]
    changes -= x
    half = halved(x)
    half = 2.0 * halved(half)
    rows[1, 0] = x
    lifted = lift(rows, rows[0, 0])
    x, half = half, x
    found[0] = x + 10.0 * half + 100.0 * lifted + changes


def test_a_kernel_computes_what_it_says(monkeypatch):
    backend.start(Settings(arch="cpu"))
    monkeypatch.setattr(compiler, "unrolls", True)
    for each in (compute._primal, halved.func, lift.func):
        monkeypatch.setattr(each.func, "__module__", "taichi_nmm.kernel")
    found = np.zeros(1)
    compute(np.ones(1), found)
    assert found[0] == -89.5


@pytest.mark.skipif(
    compiler.COMPILER != "taichi", reason="reads a function once anyway"
)
def test_a_function_is_read_once(monkeypatch):
    @ti.kernel
    def twice(values: Array):
        values[0] = halved(values[0]) + halved(values[0])

    read = []

    def note(function, **words):
        read.append(function.func.__name__)
        return taichis_own(function, **words)

    backend.start(Settings(arch="cpu"))
    monkeypatch.setattr(halved.func.func, "__module__", "taichi_nmm.kernel")
    taichis_own = compiler._read_function
    monkeypatch.setattr(compiler, "_read_function", note)
    monkeypatch.setattr(compiler, "_trees", {})
    values = np.full(1, 3.0)
    twice(values)
    assert values[0] == 3.0
    assert read == ["twice", "halved"]

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
    rows[1, 0] = x
    lifted = lift(rows, rows[0, 0])
    x, half = half, x
    found[0] = x + 10.0 * half + 100.0 * lifted + changes


def test_a_kernel_computes_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    backend.start(Settings(arch="cpu"))
    monkeypatch.setattr(compiler, "unrolls", True)
    for each in (compute._primal, halved.func, lift.func):
        monkeypatch.setattr(each.func, "__module__", "taichi_nmm.kernel")
    found = np.zeros(1)
    compute(np.ones(1), found)
    assert found[0] == -89.5

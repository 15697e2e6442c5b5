"""Elementary functions against NumPy: interpreted in float64, compiled in float32."""

import numpy as np
import pytest

from taichi_nmm.kernel import backend
from taichi_nmm.kernel.elementary import arctangent2, sine_cosine, two_to
from taichi_nmm.settings import Settings
from tests.parity.interpreter import interpreted_walker

ANGLES = np.concatenate([np.linspace(-60.0, 60.0, 20001), np.arange(-8, 9) * np.pi / 4])


@pytest.fixture(scope="module")
def elementary():
    return interpreted_walker().muscle.two_to.__globals__


def test_sine_cosine_and_arctangent_in_all_quadrants(elementary):
    sine, cosine = elementary["sine_cosine"](ANGLES)
    assert np.abs(sine - np.sin(ANGLES)).max() < 1e-14
    assert np.abs(cosine - np.cos(ANGLES)).max() < 1e-14
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 10000)) * rng.choice([1e-6, 1.0, 1e6], (2, 10000))
    x[:4], y[:4] = [1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]
    assert np.abs(elementary["arctangent2"](y, x) - np.arctan2(y, x)).max() < 1e-14


def test_powers_of_two_and_their_clamp(elementary):
    x = np.linspace(-120.0, 120.0, 20001)
    two_to = elementary["two_to"]
    assert np.abs(two_to(x) / np.exp2(x) - 1.0).max() < 1e-13
    ends = two_to(np.array([-1e9, 1e9, np.nan]))
    assert np.allclose(ends, np.exp2([-120.0, 120.0, -120.0]))


def test_larger_and_smaller_keep_the_first_where_the_second_is_nan(elementary):
    x, y = np.array([1.0, 3.0, np.nan, 1.0]), np.array([2.0, 2.0, 2.0, np.nan])
    assert np.array_equal(
        elementary["larger"](x, y), [2.0, 3.0, np.nan, 1.0], equal_nan=True
    )
    assert np.array_equal(
        elementary["smaller"](x, y), [1.0, 2.0, np.nan, 1.0], equal_nan=True
    )


def test_compiled_in_float32():
    ti = backend.ti
    backend.start(Settings(precision="float32", arch="cpu"))

    @ti.kernel
    def apply(x: ti.types.ndarray(), out: ti.types.ndarray()):
        for i in range(x.shape[0]):
            s, c = sine_cosine(x[i])
            out[0, i] = s
            out[1, i] = c
            out[2, i] = two_to(x[i])
            out[3, i] = arctangent2(x[i], 2.0 - x[i])

    x = np.linspace(-20.0, 20.0, 4001, dtype=np.float32)
    out = np.zeros((4, len(x)), np.float32)
    apply(x, out)
    exact = x.astype(np.float64)
    assert np.abs(out[0] - np.sin(exact)).max() < 5e-7
    assert np.abs(out[1] - np.cos(exact)).max() < 5e-7
    assert np.abs(out[2] / np.exp2(exact) - 1.0).max() < 5e-7
    assert np.abs(out[3] - np.arctan2(exact, 2.0 - exact)).max() < 1e-6

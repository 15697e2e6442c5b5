"""Launching a kernel: refusals of a driver, and errors of ours."""

from collections.abc import Callable

import numpy as np
import pytest

from taichi_nmm.errors import InputError
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.backend import ti
from taichi_nmm.settings import Settings

REFUSAL = "no shader float64\nin driver"


def failing() -> None:
    raise RuntimeError(REFUSAL)


@pytest.fixture
def on(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Pretend that an architecture runs on which nothing has been launched yet."""

    def pretend(arch: str) -> None:
        monkeypatch.setattr(backend, "_arch", arch)
        monkeypatch.setattr(backend, "_compiled", set())

    return pretend


def test_a_driver_that_refuses_a_kernel_is_bad_input_each_time(on: Callable[[str], None]) -> None:
    for arch in ("cuda", "vulkan"):
        on(arch)
        for _ in range(2):
            with pytest.raises(InputError, match=r"no shader float64 in driver") as caught:
                backend.launch(failing)
            assert (caught.value.field, caught.value.value) == ("simulation.arch", arch)


def test_an_error_on_the_cpu_or_after_a_launch_is_no_ones_input(on: Callable[[str], None]) -> None:
    on("cpu")
    with pytest.raises(RuntimeError, match=REFUSAL):
        backend.launch(failing)
    on("vulkan")
    outcomes = iter([None, RuntimeError(REFUSAL)])

    def fails_later() -> None:
        if error := next(outcomes):
            raise error

    backend.launch(fails_later)
    with pytest.raises(RuntimeError, match=REFUSAL):
        backend.launch(fails_later)


def test_a_bound_kernel_takes_other_numbers_on_any_device(on: Callable[[str], None]) -> None:
    @ti.kernel
    def add(values: ti.types.ndarray(), amount: int):  # type: ignore[no-untyped-def, valid-type]
        for i in range(values.shape[0]):
            values[i] += amount

    backend.start(Settings(arch="cpu"))
    values = np.zeros(3, np.float32)
    for arch in ("cpu", "cuda"):
        on(arch)
        bound = backend.BoundKernel(add, values, 1)
        bound.launch(amount=2)
        bound.launch(amount=5)
    assert values.tolist() == [14.0, 14.0, 14.0]


def test_a_kernel_in_a_class_of_the_user_is_still_a_method() -> None:
    @ti.data_oriented
    class Doubling:
        @ti.kernel
        def run(self, values: ti.types.ndarray()):  # type: ignore[no-untyped-def, valid-type]
            for i in range(values.shape[0]):
                values[i] = 2.0 * values[i]

    backend.start(Settings(arch="cpu"))
    values = np.ones(3, np.float32)
    Doubling().run(values)
    assert values.tolist() == [2.0, 2.0, 2.0]

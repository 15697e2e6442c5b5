"""Launching a kernel: refusals of a driver, and errors of ours."""

from collections.abc import Callable

import pytest

from taichi_nmm.errors import InputError
from taichi_nmm.kernel import backend

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

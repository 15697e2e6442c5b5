"""Launching a kernel, the compiler of kernels, and wide registers."""

import ctypes
import os
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from taichi_nmm import Settings
from taichi_nmm.kernel import backend, compiler, program, registers
from taichi_nmm.kernel.backend import ti
from taichi_nmm.kernel_cache import COMPILER
from tests.cases import refused

REFUSAL = "no shader float64\nin driver"


def failing():
    raise RuntimeError(REFUSAL)


@pytest.fixture
def on(monkeypatch):
    """Pretend that an architecture runs on which nothing has been launched yet."""

    backend.start(Settings(arch="cpu"))

    def pretend(arch):
        monkeypatch.setattr(backend, "_arch", arch)
        monkeypatch.setattr(backend, "_compiled", set())

    return pretend


def test_a_driver_that_refuses_a_kernel_is_bad_input_each_time(on):
    on("cuda")
    for _ in range(2):
        line = r"^simulation\.arch: 'cuda' .*no shader float64 in driver"
        with refused(line):
            backend.launch(failing)


def test_a_driver_without_a_device_is_no_architecture(monkeypatch):
    """Its kernels run, and no number arrives: walks would be wrong without a word."""
    monkeypatch.setattr(backend.program, "begin", lambda arch: True)
    monkeypatch.setattr(backend, "_double", lambda values: None)
    with refused(r"^simulation\.arch: 'cuda'"):
        backend._find_program(Settings(arch="cuda"), is_same=True)


def test_an_error_on_the_cpu_or_after_a_launch_is_no_ones_input(on):
    on("cpu")
    with pytest.raises(RuntimeError, match=REFUSAL):
        backend.launch(failing)
    on("cuda")
    outcomes = iter([None, RuntimeError(REFUSAL)])

    def fails_later():
        if error := next(outcomes):
            raise error

    backend.launch(fails_later)
    with pytest.raises(RuntimeError, match=REFUSAL):
        backend.launch(fails_later)


def test_a_bound_kernel_takes_other_numbers_on_any_device(on):
    @ti.kernel
    def add(values: ti.types.ndarray(), amount: int):
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


def test_kernels_leave_the_size_of_the_device_to_the_program():
    backend.start(Settings(arch="cpu"))
    options = program.options(program.living(), "float32", None)
    # Else a GPU has no blocks, and the compiler aborts the process.
    assert not {"max_block_dim", "saturating_grid_dim"} & set(options)


def test_a_kernel_in_a_class_of_the_user_is_still_a_method():
    @ti.data_oriented
    class Doubling:
        @ti.kernel
        def run(self, values: ti.types.ndarray()):
            for i in range(values.shape[0]):
                values[i] = 2.0 * values[i]

    backend.start(Settings(arch="cpu"))
    values = np.ones(3, np.float32)
    Doubling().run(values)
    assert values.tolist() == [2.0, 2.0, 2.0]


PINNED = {"taichi": "1.7.4", "quadrants": "1.4.0"}


def test_each_python_has_its_compiler_and_results_name_it():
    assert ("quadrants" if sys.version_info >= (3, 14) else "taichi") == COMPILER
    assert compiler.VERSION == version(COMPILER) == PINNED[COMPILER]
    backend.start(Settings(arch="cpu"))
    engine = backend.metadata()
    assert (engine["engine"], engine["engine_version"]) == (COMPILER, PINNED[COMPILER])
    assert compiler.ti.__name__ == COMPILER


def test_the_source_of_a_kernel_is_read_once_and_no_class_is_looked_for():
    module = (
        compiler.kernel_impl if COMPILER == "taichi" else compiler.ti.lang._func_base
    )
    name = "getsourcelines" if COMPILER == "taichi" else "get_source_info_and_src"
    assert hasattr(getattr(module, name), "cache_info")
    assert compiler.kernel_impl._inside_class is compiler._inside_class


LIBRARY, VERSION = compiler.core.__file__, registers.TAICHI_VERSION


@pytest.mark.skipif(not registers._address_of_setting(LIBRARY), reason="another system")
def test_only_this_library_of_this_version_is_told(tmp_path):
    setting = ctypes.c_uint32.from_address(registers._address_of_setting(LIBRARY) or 0)
    before = setting.value
    cut = tmp_path / "cut"
    cut.write_bytes(Path(LIBRARY).read_bytes()[:4096])
    for other in ("/proc/self/exe", os.devnull, __file__, str(cut), "none"):
        assert not registers.tell_vectoriser(5, other, VERSION)
    assert (
        not registers.tell_vectoriser(5, LIBRARY, (1, 7, 5)) and setting.value == before
    )
    assert (
        registers.tell_vectoriser(before, LIBRARY, VERSION) and setting.value == before
    )


def test_the_width_is_known_unknown_or_switched_off(monkeypatch):
    for features, width in (
        ("fpu avx2 avx512vl", 16),
        ("fpu avx2", 8),
        ("fpu avx512vlx", 0),
    ):
        monkeypatch.setattr(Path, "read_text", lambda _path, text=features: text)
        assert registers.width() == width
    monkeypatch.setenv(registers.VARIABLE, "0")
    assert registers.width() == 0
    monkeypatch.setenv(registers.VARIABLE, "yes")
    with refused(registers.VARIABLE):
        registers.width()


def test_only_remarks_are_kept_off_standard_error(capfd):
    with registers.without_remarks():
        os.write(2, registers.REMARK + b": a call\nan error\n")
    assert capfd.readouterr().err == "an error\n"

"""A script that uses the compiler itself: its fields live, and results keep their bits.

Each script runs in a process of its own: a process has one program of the compiler at a
time.
"""

import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from taichi_nmm.kernel_cache import COMPILER

LONGEST_S = 120.0  # a launch with the script's options compiled for minutes

HEAD = (
    f"import {COMPILER} as ti\n"
    + """
import taichi_nmm
from taichi_nmm import InputError, Settings, Controller, Observation

gains = [taichi_nmm.load_gains("reference"), taichi_nmm.PUBLISHED_GAINS]


def walked(**settings):
    settings = Settings(**{"arch": "cpu", **settings})
    return taichi_nmm.simulate(gains, duration_s=0.5, settings=settings).rows.tobytes()


@ti.kernel
def double(x: ti.template()):
    for i in x:
        x[i] = 2.0 * i


def refusal(**settings):
    try:
        walked(**settings)
    except InputError as error:
        print(error)


def fields_live(*fields):
    for field in fields:
        double(field)
        assert field.to_numpy().tolist() == [0.0, 2.0, 4.0]
"""
)

SCRIPTS = {
    "before": """
ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=1)
x = ti.field(float, 3)
fields_live(x)
print(walked().hex())
assert x.to_numpy().tolist() == [0.0, 2.0, 4.0] and x.dtype == ti.f64
y = ti.field(float, 3)
print(walked(precision="float64").hex())
fields_live(x, y)
assert y.dtype == ti.f64 and ti.cfg.fast_math and ti.cfg.cfg_optimization
""",
    "between": """
print(walked().hex())
ti.init(arch=ti.cpu, debug=True)
x = ti.field(float, 3)
print(walked(precision="float64").hex())
fields_live(x)
assert ti.cfg.debug
ti.init(arch=ti.cpu)
x = ti.field(float, 3)
again = walked()
fields_live(x)
print(again.hex())
""",
    "in the program that we began": """
print(walked().hex())
x, y = ti.field(float, 3), ti.ndarray(float, 3)
y.fill(5.0)
print(walked(precision="float64").hex())
assert y.to_numpy().tolist() == [5.0, 5.0, 5.0]
fields_live(x)
""",
    "after ti.reset": """
print(walked().hex())
ti.reset()
print(walked(precision="float64").hex())
""",
}
EXPECTED = """
print(walked().hex())
print(walked(precision="float64").hex())
"""


@cache
def results(script):
    """What a script has printed of results; it ended well, without a word on standard error."""
    with TemporaryDirectory() as folder:
        file = Path(folder, "script.py")  # the compiler reads the source of kernels
        file.write_text(HEAD + script, encoding="utf-8")
        words = [sys.executable, str(file)]
        done = subprocess.run(
            words, capture_output=True, text=True, timeout=LONGEST_S, check=False
        )
    assert (done.returncode, done.stderr) == (0, "")
    return [line for line in done.stdout.splitlines() if not line.startswith("[")]


@pytest.fixture(scope="module")
def expected():
    """Of float32 and float64, in a script that does not use the compiler."""
    single, double = results(EXPECTED)
    assert single != double
    return [single, double]


@pytest.mark.parametrize("when", SCRIPTS)
def test_a_script_that_uses_the_compiler_keeps_its_fields(when, expected):
    found = results(SCRIPTS[when])
    assert found[:2] == expected
    assert found[2:] in ([], [expected[0]])


CONTROLLER = """
import numpy as np

senses = dict(joint_rad=np.zeros((1, 6)), joint_rate_radps=np.zeros((1, 6)), trunk_rad=[0.05])
senses |= dict(trunk_rate_radps=[0.0], contact=[[1, 0]], load_n=[[700.0, 0.0]])
senses |= dict(leg_length_m=[[1.0, 1.0]], leg_angle_rad=[[1.5, 1.6]], com_ahead_m=[[0.1, 0.0]])
observation = Observation(**senses, com_speed_mps=[1.2])


def torques(at_once):
    controller, found = Controller(gains[:1]), []
    for step in range(4):
        if step == 2 and not at_once:
            ti.init(arch=ti.cpu)
            x = ti.field(float, 3)
        found.append(controller.step(observation))
    if not at_once:
        fields_live(x)
    return np.array(found)


assert np.isfinite(torques(True)).all() and torques(True)[-1].any()
assert torques(True).tolist() == torques(False).tolist()
"""


def test_a_controller_goes_on_after_another_ti_init():
    assert results(CONTROLLER) == []


NO_PLACE = """
ti.init(arch=ti.cpu)
x = ti.field(float)
refusal()
"""
ELSEWHERE = """
ti.init(arch=ti.cpu)
x = ti.field(float, 3)
refusal(arch="cuda")
fields_live(x)
"""

FORKED = """
import os

ti.init(arch=ti.cpu)
child = os.fork()
if not child:
    refusal()
    os.sys.stdout.flush()
    os._exit(0)
os.waitpid(child, 0)
"""


@pytest.mark.parametrize(
    ("script", "line"),
    [
        (FORKED, "process: .*multiprocessing.get_context\\('spawn'\\).* or ti.init"),
        (NO_PLACE, "taichi: .*fields.*; allowed: all fields placed"),
        (
            ELSEWHERE,
            "simulation.arch: 'cuda' .*allowed: cpu, on which this script's own",
        ),
    ],
)
def test_what_is_not_possible_is_one_line(script: str, line: str) -> None:
    (said,) = results(script)
    assert re.match(line, said)

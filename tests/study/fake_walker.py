"""A walker of one formula in place of the simulator, stores made with it, and a toy experiment.

A walker's quality falls with the distance of its gains from the middle of their ranges;
its body and its ground take something off. Whoever passes WALKS_FROM walks to the end.
Trials take milliseconds.
"""

import os
import signal
import time
from unittest import mock

import numpy as np

import taichi_nmm
from storage.inputs.config import Table
from storage.precompute import precompute
from storage.specification import read_specification
from study.experiment.arms import ARMS, lacks
from study.experiment.walker import read_experiment
from taichi_nmm.body import Bodies
from taichi_nmm.parameters import gain_rows, lower_bounds, upper_bounds
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, Result, Trajectory
from taichi_nmm.terrain import Terrain

# For those who want to kill it: seconds that a call takes, and a signal that this
# process gets in a call of it, such as "5:SIGKILL".
TRIAL_S = float(os.environ.get("FAKE_TRIAL_S", "0"))
SIGNAL = os.environ.get("FAKE_SIGNAL", "")
WALKS_FROM = 0.7  # quality
WIDTHS = (9, 9, 6, 14, 14, 4, 6, 4, 6, 1, 14, 14, 22, 2, 3)  # of a trajectory's arrays
# It cannot be drawn.
EMPTY = Trajectory(
    0,
    np.empty(0),
    *(np.empty((0, width)) for width in WIDTHS),
    prosthesis=np.zeros(2, bool),
    push=np.zeros(3),
    slip=np.zeros(3),
)
STORE_ROWS = 150
# Of families, each with one of longer walks.
KINDS = ("rough", "blocks", "up", "down", "stairs")
ABLE = tuple(name for name in ARMS if not lacks(name))  # arms that can run here
THETA_REF = 7  # of the low-level gains
DEFAULTS = {
    "duration_s": 5.0,
    "bodies": None,
    "terrains": None,
    "terrain_index": 0,
    "low_level_gains": None,
    "settings": None,
    "record": (),
    "progress": None,
}

calls = []  # what the simulator was called with


def quality(gains):
    """Of each row of gains, 0 to 1, [n]."""
    unit = (gains - lower_bounds()) / (upper_bounds() - lower_bounds())
    return np.exp(-np.mean((2.0 * unit[:, :6] - 1.0) ** 2, axis=1) * 1.5)


def simulate(gains, **options):
    """What `taichi_nmm.simulate` promises, with empty trajectories."""
    time.sleep(TRIAL_S)
    number, _, name = SIGNAL.partition(":")
    if number == str(len(calls) + 1):
        signal.raise_signal(signal.Signals[name])
    tried, call = gain_rows(gains), DEFAULTS | options
    calls.append({"gains": tried, **call})
    duration_s = call["duration_s"]
    good = quality(tried) * share_left(call, len(tried))
    walked = good >= WALKS_FROM
    rows = np.zeros(len(tried), RESULT_DTYPE)
    rows["duration_s"] = np.where(walked, duration_s, duration_s * good)
    rows["end_reason"] = np.where(walked, COMPLETED, FELL)
    rows["survived_fraction"] = rows["duration_s"] / duration_s
    rows["mean_speed_mps"] = 1.3 * good
    rows["distance_m"] = rows["mean_speed_mps"] * rows["duration_s"]
    rows["step_count"] = np.ceil(rows["duration_s"])
    rows["phi_printed"] = np.round(50.0 * good)  # with ties, as of real walks
    rows["phi_corrected"] = rows["phi_printed"]
    for number in range(1, 5):
        rows[f"m{number}_mean"] = np.sin(number + 7.0 * good)
    rows["m5_mean_mps"] = good
    rows["activation_cubed_mean"] = 1.0 - good
    # Who spends least with the muscles alone does not with the motors.
    rows["cost_of_transport_jpkgpm"] = 3.0 + np.sin(9.0 * tried[:, 0])
    motors = 1.0 - np.sin(9.0 * tried[:, 0]) + np.cos(7.0 * tried[:, 1])
    rows["cost_of_transport_powered_jpkgpm"] = rows["cost_of_transport_jpkgpm"] + motors
    if call["progress"] is not None:
        call["progress"](duration_s, 0)
    return Result(rows, (EMPTY,) * len(call["record"]), {"engine": "fake"})


def share_left(call, count):
    """What ground, body and low-level gains leave of the quality of each walker, [count]."""
    bodies, grounds = call["bodies"] or Bodies.nominal(), call["terrains"] or []
    if isinstance(grounds, Terrain):
        grounds = [grounds]
    rough = np.array([np.std(np.diff(ground.height_m)) for ground in grounds] or [0.0])
    mass = np.resize(bodies.mass_kg.sum(axis=1), count)
    left = np.exp(-10.0 * rough[call["terrain_index"]] - abs(mass / 80.0 - 1.0) / 5.0)
    if call["low_level_gains"] is not None:
        left *= np.exp(-np.abs(np.atleast_2d(call["low_level_gains"])[:, THETA_REF]))
    return left


def stopped_in_call(number, error=KeyboardInterrupt):
    """`simulate`, but an error ends its call of that number, counted from 1, and later ones."""
    from tests.storage.fake import stopping  # pytest, which processes do without

    return stopping(number - 1, simulate, error)


def fill(path, data):
    """Fill a store with fake scores."""
    with mock.patch.dict(vars(taichi_nmm), simulate=simulate):
        precompute(read_specification(Table(data)), path)


def write_plain_store(path, samples=200):
    """A store of fake scores on level ground alone."""
    fill(path, {"samples": samples, "seed": 3})


def write_store(path, **changes):
    """A store of fake scores with families."""
    settings = {
        "settings": 1,
        "min_survival_s": 1.0,
        "terrain": {"kind": "rough", "amplitude_m": 0.08},
        "body": {"disturbance": 0.15},
    }
    families = {name: settings | {"seed": seed} for seed, name in enumerate(KINDS)}
    for name in KINDS:
        families[f"{name}_long"] = settings | {
            "after": name,
            "min_survived_fraction": 0.5,
        }
    data = {"samples": STORE_ROWS, "seed": 3, "robust": settings, "families": families}
    fill(path, data | changes)


CONFIG = """
name = "toy"
seed = 5
runs = 3
trials = 8
arms = ["random", "dog", "ranking"]
{top}
objective.cost = "smooth"
simulation.duration_s = 20.0
body.disturbance = 0.15
terrain.kind = "rough"
stores = {{flat = "{store}", worlds = "{store}", stairs = "{store}"}}
"""


def write_config(folder, top=""):
    """A configuration in a folder, and the store that it names."""
    store = folder / "store"
    if not store.exists():
        searched = {"searched": ["theta_ref"]} if "theta_ref" in top else {}
        write_store(store, **searched)
    path = folder / "toy.toml"
    path.write_text(CONFIG.format(top=top, store=store))
    return path


def experiment(folder, top=""):
    """The experiment of `write_config`."""
    return read_experiment(write_config(folder, top))

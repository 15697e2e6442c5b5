"""Walks whose bodies MuJoCo moves: how they go, and that no walker feels another."""

from itertools import pairwise

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch as Simulations
from mujoco.batch import SimulationError

from study.pictures.stick_figure import leg
from taichi_nmm import simulate, terrain
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from taichi_nmm.kernel_cache import COMPILER
from taichi_nmm.parameters import (
    LOW_LEVEL_GAINS,
    PUBLISHED_GAINS,
    load_gains,
    lower_bounds,
    upper_bounds,
)
from taichi_nmm.settings import MujocoSettings, Settings

pytestmark = pytest.mark.slow

MUJOCO = Settings(engine="mujoco", arch="cpu")
WALKERS = 10  # two packs, one of them not full
SHORT_S = 1.0
LONG_S = 30.0


@pytest.fixture(scope="module")
def long_walk():
    """The published gains and the reference on level ground."""
    gains = [PUBLISHED_GAINS, load_gains("reference")]
    return simulate(gains, duration_s=LONG_S, settings=MUJOCO, record=[0, 1])


def test_gaits_walk_at_their_speeds_and_metadata_name_the_engines(long_walk):
    assert long_walk.end_reason.tolist() == ["completed"] * 2
    assert long_walk["mean_speed_mps"][0] == pytest.approx(1.40, abs=0.03)
    assert long_walk["mean_speed_mps"][1] == pytest.approx(1.27, abs=0.04)
    np.testing.assert_allclose(
        long_walk["grf_vertical_mean_bw"], 1.0, rtol=0, atol=0.002
    )
    metadata = long_walk.metadata
    assert (
        metadata["engine"] == "mujoco"
        and metadata["engine_version"] == mujoco.__version__
    )
    assert metadata["mujoco"] == {
        "time_constant_s": 0.02,
        "damping_ratio": 1.0,
        "limits": "stops",
    }
    assert metadata["physics_step_s"] == 1e-3 and metadata["precision"] == "float32"
    assert metadata["controller"]["engine"] == COMPILER


def test_a_trajectory_is_recorded(long_walk):
    weight_n = Bodies.nominal().mass_kg.sum() * GRAVITY_MPS2
    for row, path in zip(long_walk.rows, long_walk.trajectories, strict=True):
        assert np.isfinite(path.q).all() and np.isfinite(path.qdot).all()
        assert path.q[-1, 0] == pytest.approx(row["hip_x_m"], abs=0.05)
        walked_m = np.trapezoid(path.qdot[:, 0], path.time_s)
        assert walked_m == pytest.approx(path.q[-1, 0] - path.q[0, 0], abs=0.05)
        forces = path.ground_force_n
        assert forces[:, [1, 3]].sum(axis=1).mean() == pytest.approx(weight_n, rel=0.01)
        # Forces act on feet that are on the ground, and swing alternates with stance.
        both_up = ~path.stance.any(axis=1)
        assert both_up.mean() < 0.05 and 0.5 < path.stance.mean() < 0.7
        assert set(path.events["kind"]) == set(path.events["side"]) == {0, 1}
        assert np.abs(path.joint_rad).max() < 2.0


def test_effort_work_and_peaks_of_torque_are_those_of_a_recording():
    """Of the engine whose recorded torques have no stops; a step goes from take-off to take-off."""
    worn = [
        20.0 if gain.name == "exo_torque" else gain.default for gain in LOW_LEVEL_GAINS
    ]
    found = simulate(
        PUBLISHED_GAINS,
        duration_s=6.0,
        settings=MUJOCO,
        record=[0],
        record_rate_hz=1000,
        low_level_gains=worn,
    )
    (row,), (path,) = found.rows, found.trajectories
    for power, name in ((2, "activation_squared_mean"), (3, "activation_cubed_mean")):
        assert row[name] == pytest.approx((path.activation**power).mean(), rel=2e-3)
    assert path.device_torque_nm.max() > 10.0
    motors = path.device_torque_nm + np.insert(
        path.swing_torque_nm, [2, 4], 0.0, axis=1
    )
    work_j = np.maximum(motors[1:] * np.diff(path.joint_rad, axis=0), 0.0).sum()
    more = row["cost_of_transport_powered_jpkgpm"] - row["cost_of_transport_jpkgpm"]
    assert more * 80.0 * row["distance_m"] == pytest.approx(work_j, rel=2e-3)
    ankles = np.stack([leg(path.q, side).ankle[:, 0] for side in (0, 1)])
    struck = path.events[path.events["kind"] == 0]
    ahead = (ankles[0] - ankles[1])[np.searchsorted(path.time_s, struck["time_s"])]
    is_left, after = struck["side"] == 0, np.diff(struck["time_s"])
    for name, left, right in (
        ("length", ahead[is_left], -ahead[~is_left]),
        ("duration", after[is_left[1:]], after[~is_left[1:]]),
    ):
        uneven = (left.mean() - right.mean()) / (left.mean() + right.mean())
        assert (
            row[f"step_{name}_asymmetry"] == pytest.approx(uneven, abs=2e-3)
            and uneven != 0.0
        )
    events, steps = path.events[path.events["kind"] == 1], []
    torque = np.abs(path.joint_torque_nm).reshape(-1, 2, 3)
    for side in (0, 1):
        ends = np.searchsorted(
            path.time_s, events["time_s"][events["side"] == side] + 0.1
        )
        steps += [torque[first:end, side].max(axis=0) for first, end in pairwise(ends)]
    assert len(steps) == row["step_count"] > 4
    peaks = [row[f"{joint}_torque_peak_nm"] for joint in ("hip", "knee", "ankle")]
    np.testing.assert_allclose(peaks, np.mean(steps, axis=0), rtol=2e-3)


def some(rows=slice(None), **options):
    """Short walks of some of ten walkers, each on its body and its ground; most of them fall."""
    rng = np.random.default_rng(6)
    gains = rng.uniform(lower_bounds(), upper_bounds(), (WALKERS, 16))
    gains[:4] = PUBLISHED_GAINS
    kinds = (
        terrain.rough(3, flat_start_m=0.0),
        terrain.blocks(4, spacing_m=0.3, flat_start_m=0.0),
        terrain.ramp(direction="down", segment_m=0.5),
    )
    index = np.arange(WALKERS)[rows]
    return simulate(
        gains[index],
        bodies=options.pop("bodies", bodies()).take(index),
        terrains=kinds,
        terrain_index=index % len(kinds),
        duration_s=SHORT_S,
        settings=options.pop("settings", MUJOCO),
        **options,
    )


def bodies():
    return Bodies.disturbed(range(WALKERS))


@pytest.fixture(scope="module")
def together():
    return some()


def test_nobody_feels_the_others(together):
    for rows in ([0], [9], [8, 3], np.arange(WALKERS)[::-1], np.arange(8)):
        assert some(rows).rows.tobytes() == together.rows[rows].tobytes()


def test_recording_and_another_simulation_change_nothing(together):
    other = Settings(precision="float64", arch="cpu")
    simulate(PUBLISHED_GAINS, duration_s=0.01, settings=other)
    recorded = some(record=[1, 7], record_rate_hz=500.0, progress=lambda *_: None)
    assert recorded.rows.tobytes() == together.rows.tobytes()


def test_settings_matter(together):
    for own in (
        MujocoSettings(time_constant_s=0.01),
        MujocoSettings(limits="mujoco"),
        MujocoSettings(damping_ratio=0.5),
    ):
        settings = Settings(engine="mujoco", arch="cpu", mujoco=own)
        other = some([0, 1], settings=settings)
        assert (other["hip_x_m"] != together["hip_x_m"][:2]).all()


def assert_others_walk(found, together, walker):
    others = np.arange(WALKERS) != walker
    assert found.rows[others].tobytes() == together.rows[others].tobytes()


def assert_only_this_one(found, together, walker):
    assert found.end_reason[walker] == "diverged"
    assert_others_walk(found, together, walker)
    assert found["duration_s"][walker] < SHORT_S
    assert np.isfinite(found["distance_m"][walker])


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """MuJoCo would write its log there."""
    monkeypatch.chdir(tmp_path)
    yield
    assert list(tmp_path.iterdir()) == []


def those(simulations, walker, from_s):
    """Rows of this walker, which its mass tells, from this time on."""
    mass_kg = bodies().mass_kg[walker, 0]
    mine = np.array([model.body_mass[1] == mass_kg for model in simulations.models])
    return np.flatnonzero(mine & (simulations.time > from_s))


def test_a_walker_of_nans(together, monkeypatch, capfd):
    """It gets a code, nothing is printed, and no other walker changes."""
    step = Simulations.step

    def spoilt(simulations):
        rows = those(simulations, 2, 0.3)
        simulations.ctrl[rows] = simulations.qvel[rows, 0] = np.nan
        step(simulations)

    handler = mujoco.get_mju_user_warning()
    monkeypatch.setattr(Simulations, "step", spoilt)
    assert_only_this_one(some(), together, 2)
    assert mujoco.get_mju_user_warning() is handler
    assert capfd.readouterr() == ("", "")


def test_an_engines_error_is_its_walkers(together, monkeypatch):
    """MuJoCo leaves such a walker where it was, and has moved the others."""
    step = Simulations.step

    def failing(simulations):
        before, rows = simulations.state.copy(), those(simulations, 3, 0.1)
        step(simulations)
        if len(rows):
            simulations.state[rows] = before[rows]
            raise SimulationError(rows, "no memory")

    monkeypatch.setattr(Simulations, "step", failing)
    assert_only_this_one(some(), together, 3)


def test_a_body_that_no_engine_can_move(together):
    light = bodies()
    mass, inertia = light.mass_kg.copy(), light.inertia_kgm2.copy()
    mass[5], inertia[5] = 1e-9, 1e-12
    found = some(bodies=Bodies(mass, inertia, light.com_m))
    assert found.end_reason[5] in ("diverged", "fell")
    assert_others_walk(found, together, 5)


def test_recording_one_that_diverges(monkeypatch):
    step = Simulations.step

    def spoilt(simulations):
        simulations.qvel[:, 0] *= np.where(simulations.time > 0.2, 1e9, 1.0)
        step(simulations)

    monkeypatch.setattr(Simulations, "step", spoilt)
    found = some([0], record=[0])
    assert found.end_reason.tolist() == ["diverged"]
    path = found.trajectories[0]
    assert 0.15 <= path.time_s[-1] <= 0.25

"""`simulate`: results, refusals, and walkers that diverge without touching others."""

import numpy as np
import pytest

import taichi_nmm
from taichi_nmm import Bodies, Settings, Switch, load_gains, terrain
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.layout import Const, State
from taichi_nmm.parameters import (
    GAIN_NAMES,
    LOW_LEVEL_GAINS,
    LOW_LEVEL_NAMES,
    PUBLISHED_GAINS,
)
from taichi_nmm.result import COMPLETED, DIVERGED, FELL
from taichi_nmm.simulator import start_packs
from taichi_nmm.walkers import Schedule, check_batch
from tests.cases import refused
from tests.processes import printed

pytestmark = pytest.mark.slow

CPU = Settings(arch="cpu")
# The published gains without push-off and balance: falls within the first steps.
FALLING = PUBLISHED_GAINS * np.where(
    np.isin(GAIN_NAMES, ["K_SOL", "Kp_stance"]), 0.0, 1.0
)
MASKED = np.ma.masked_array(PUBLISHED_GAINS, mask=np.arange(len(PUBLISHED_GAINS)) == 3)


def walked(gains=PUBLISHED_GAINS, duration_s=2.0, **options):
    return taichi_nmm.simulate(
        gains, duration_s=duration_s, **{"settings": CPU, **options}
    )


@pytest.fixture(scope="module")
def walk():
    return walked([PUBLISHED_GAINS, FALLING], 20.0, record=[1, 0], record_rate_hz=200)


def test_walker_completes_and_faller_falls(walk):
    assert walk["end_reason"].tolist() == [COMPLETED, FELL]
    assert walk.end_reason.tolist() == ["completed", "fell"]
    assert walk["duration_s"][0] == 20.0
    assert 0.3 < walk["duration_s"][1] < 10.0
    assert walk["survived_fraction"] == pytest.approx(walk["duration_s"] / 20.0)
    assert walk["mean_speed_mps"] == pytest.approx(
        walk["distance_m"] / walk["duration_s"]
    )


def test_reference_gait_is_humanlike_and_its_score_the_sum_of_its_components(walk):
    row = walk.rows[0]
    assert row["mean_speed_mps"] == pytest.approx(1.395, abs=0.05)
    assert row["grf_vertical_mean_bw"] == pytest.approx(1.0, abs=0.01)
    assert 3.0 < row["cost_of_transport_jpkgpm"] < 7.0
    assert 0.5 < row["step_duration_mean_s"] < 0.65
    assert 0.1 < row["double_support_fraction"] < 0.25
    assert row["flight_fraction"] == 0.0
    assert np.deg2rad(4) < row["trunk_mean_rad"] < np.deg2rad(9)
    step_m = row["step_duration_mean_s"] * row["mean_speed_mps"]
    assert 0.9 * step_m < row["step_length_mean_m"] < step_m  # between ankles
    binary = row["m1_sum"] + row["m2_sum"] + row["m3_sum"] + row["m4_sum"]
    assert row["phi_printed"] == pytest.approx(binary + row["m5_sum_mps"])
    assert row["phi_corrected"] == pytest.approx(binary + row["m5_corrected_sum"])
    for name in ("m1", "m2", "m3", "m4"):
        assert 0 <= row[f"{name}_sum"] <= row["step_count"]
        assert row[f"{name}_sum"] == round(row[f"{name}_sum"])
        assert row[f"{name}_mean"] == pytest.approx(
            row[f"{name}_sum"] / row["step_count"]
        )


def test_trajectory_agrees_with_the_result_and_recording_changes_no_bit(walk):
    faller, walker = walk.trajectories
    assert (faller.walker, walker.walker) == (1, 0)
    assert len(walker.time_s) == 4000
    assert np.allclose(np.diff(walker.time_s), 0.005)
    assert faller.time_s[-1] <= walk["duration_s"][1]
    assert walker.q[-1, 0] == walk["hip_x_m"][0]
    joints = walker.q[:, [3, 4, 5]] - walker.q[:, [2, 3, 4]]
    assert np.allclose(walker.joint_rad[:, :3], joints)
    weight = 80.0 * 9.81  # kg, m/s2
    vertical = walker.ground_force_n[:, [1, 3]].sum(axis=1)
    assert vertical[400:].mean() == pytest.approx(weight, rel=0.02)
    assert vertical.mean() == pytest.approx(
        walk["grf_vertical_mean_bw"][0] * weight, rel=1e-4
    )
    airborne = ~walker.stance.any(axis=1)
    assert np.abs(vertical[airborne]).max(initial=0.0) < 0.5 * weight
    assert walker.muscle_force_n.min() >= 0 and walker.activation.min() > 0
    # Events alternate and make the step count.
    events = walk.trajectories[1].events
    assert (np.diff(events["time_s"]) >= 0).all()
    for side in (0, 1):
        kinds = events[(events["side"] == side)]["kind"]
        assert (np.diff(kinds.astype(int)) != 0).all()  # strike, take-off, strike, ...
    # A step needs a whole swing and its stance's end: both legs' first strikes and
    # take-offs less.
    takeoffs = int((events["kind"] == 1).sum())
    assert walk["step_count"][0] == takeoffs - 2
    # Recording changes no bit.
    plain = walked([PUBLISHED_GAINS, FALLING], 20.0)
    assert plain.rows.tobytes() == walk.rows.tobytes()
    assert plain.trajectories == ()


def test_progress_and_interrupt():
    seen = []

    def watch(simulated_s, active):
        seen.append((simulated_s, active))
        if simulated_s >= 1.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        walked([PUBLISHED_GAINS] * 3, 5.0, progress=watch)
    assert seen == [(0.25, 3), (0.5, 3), (0.75, 3), (1.0, 3)]


def test_divergence_is_a_code_and_touches_no_neighbour():
    gains = np.tile(PUBLISHED_GAINS, (9, 1))
    gains[4, GAIN_NAMES.index("Kp_swing")] = 1e30
    result = walked(gains)
    assert result["end_reason"][4] == DIVERGED
    assert all(
        np.isfinite(result[name]).all() for name in result.rows.dtype.names or ()
    )
    others = np.delete(result.rows, 4)
    assert len({row.tobytes() for row in others}) == 1
    assert others[0].tobytes() == walked().rows[0].tobytes()


@pytest.mark.parametrize("gain", [1e300, 1e38, -1e30])
def test_divergence_in_the_first_tick_is_a_code_while_recorded(gain):
    gains = [PUBLISHED_GAINS, np.full(len(PUBLISHED_GAINS), gain)]
    result = walked(gains, 0.5, record=[1, 0])
    first, second = result.trajectories
    assert result.end_reason.tolist() == ["completed", "diverged"]
    assert (first.walker, len(first.time_s), first.ground_force_n.shape) == (
        1,
        0,
        (0, 4),
    )
    assert (
        first.q.shape == (0, 9)
        and first.stance.shape == (0, 2)
        and not len(first.events)
    )
    assert len(second.time_s) == 50
    np.testing.assert_array_equal(result.rows[:1], walked(duration_s=0.5).rows)


def test_a_walker_that_is_recorded_twice_has_two_equal_trajectories():
    once, twice = (walked(duration_s=0.1, record=record) for record in ([0], [0, 0]))
    for trajectory in twice.trajectories:
        np.testing.assert_array_equal(trajectory.time_s, once.trajectories[0].time_s)
    assert len(twice.trajectories) == 2


@pytest.mark.parametrize("engine", ["taichi", "mujoco"])
def test_grounds_at_the_bounds_end_walks_with_a_code(engine):
    high = terrain.HIGHEST_M
    cliffs = [
        terrain.Terrain(
            "comb", np.where(np.arange(terrain.GRID_NODES) % 2, high, -high)
        ),
        terrain.Terrain("wall", np.where(terrain.GRID_X_M > 0.1, high, -high)),
        terrain.Terrain("high", np.full(terrain.GRID_NODES, high)),
        terrain.stairs(1.0, 0.1, 0.0),
    ]
    settings = Settings(engine=engine, arch="cpu")
    gains = [PUBLISHED_GAINS] * len(cliffs)
    result = walked(gains, 0.5, settings=settings, terrains=cliffs, record=[0, 1])
    assert set(result.end_reason) <= {"completed", "fell", "diverged"}
    ended = result["end_reason"] != DIVERGED
    for name in result.rows.dtype.names or ():
        assert np.isfinite(result[name][ended]).all(), name


def test_every_kind_of_input_reaches_the_walker():
    bodies = Bodies.nominal(4)
    bodies.mass_kg[1, 0] *= 1.1
    low_level = np.tile([parameter.default for parameter in LOW_LEVEL_GAINS], (4, 1))
    low_level[3, LOW_LEVEL_NAMES.index("theta_ref")] += 0.05
    grounds = [terrain.flat(), terrain.ramp(increment=0.05, segment_m=0.5)]
    result = walked(
        [PUBLISHED_GAINS] * 4,
        3.0,
        bodies=bodies,
        low_level_gains=low_level,
        terrains=grounds,
        terrain_index=[0, 0, 1, 0],
    )
    assert len(set(result["hip_x_m"].tolist())) == 4
    # The first one walks as alone on the flat.
    assert result.rows[:1].tobytes() == walked(duration_s=3.0).rows.tobytes()


def test_gains_go_over_to_others_on_a_straight_line():
    """Walkers that take the lanes of others keep their own gains."""
    settings = Settings(arch="cpu")
    backend.start(settings)
    last = backend.lanes()  # alone in the second pack
    gains = np.outer(np.arange(1.0, last + 2.0), PUBLISHED_GAINS)
    switches = [
        Switch(1.0, 3.0 * gains, over_s=0.5),
        Switch(2.0, PUBLISHED_GAINS, over_s=0.001),
    ]
    batch = check_batch(gains)
    schedule = Schedule(batch, settings, switches)
    packs = start_packs(batch, settings)
    for tick, factor, ticks in (
        (0, 1.0, 250),
        (900, 1.0, 100),
        (1000, 1.0, 10),
        (1240, 1.96, 10),
        (1495, 2.98, 5),
        (1500, 3.0, 250),
        (1999, 3.0, 1),
        (2000, 3.0, 1),
        (2001, 0.0, 250),
        (9000, 0.0, 250),
    ):
        assert schedule.set_constants(packs, tick) == ticks
        pack, lane = packs.lane_of(last) or (-1, -1)
        k_sol, total_mass = packs.constants[
            pack, [Const.K_SOL + 1, Const.total_mass], lane
        ]
        expected = gains[last, 3] * factor or PUBLISHED_GAINS[3]
        assert k_sol == pytest.approx(expected, rel=1e-6) and total_mass == 80.0
        assert (pack, lane) == ((1, 0) if tick == 0 else (0, 5))
        packs.rows[0, State.active, 5] = float(tick > 0)
        packs.compact()


@pytest.mark.parametrize("engine", ["taichi", "mujoco"])
def test_a_walk_with_a_switch_is_that_of_the_first_gains_until_then(engine):
    settings = Settings(arch="cpu", engine=engine)
    reference = load_gains("reference")
    plain, same, other = (
        walked(duration_s=1.5, settings=settings, record=[0], switches=switches)
        for switches in (
            (),
            [Switch(0.3, PUBLISHED_GAINS)],
            [Switch(0.7, reference, over_s=0.2)],
        )
    )
    np.testing.assert_array_equal(same.trajectories[0].q, plain.trajectories[0].q)
    moved = (other.trajectories[0].q != plain.trajectories[0].q).any(axis=1)
    first = plain.trajectories[0].time_s[moved][0]
    assert 0.7 < first < 0.75


def test_settings_change_the_walk():
    base = walked()["hip_x_m"][0]
    for change in ({"contact_relaxation_speed_mps": 0.03}, {"physics_step_s": 0.5e-3}):
        x = walked(settings=Settings(arch="cpu", **change))["hip_x_m"][0]
        assert x != base
        assert x == pytest.approx(base, abs=0.15)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gains": np.zeros(15)}, r"gains\.shape"),
        ({"gains": np.zeros((0, 16))}, r"gains\.shape: \(0, 16\) .*one row at least"),
        ({"gains": np.full(16, np.nan)}, r"gains\[0\]\.K_GAS: nan"),
        ({"gains": "much"}, "gains"),
        ({"duration_s": 0.0}, "duration_s: 0.0"),
        ({"duration_s": float("nan")}, "duration_s"),
        ({"bodies": Bodies.nominal(3)}, "bodies: 3"),
        ({"terrains": []}, "terrains"),
        ({"terrains": [terrain.flat()] * 3}, "terrains: 3"),
        ({"terrain_index": [1, 0]}, "terrain_index"),
        ({"terrain_index": [0.0, 0.0]}, "terrain_index"),
        ({"low_level_gains": np.zeros(7)}, r"low_level_gains\.shape"),
        ({"record": [2]}, "record: 2"),
        ({"record": [0], "record_rate_hz": 300.0}, "record_rate_hz: 300"),
        (
            {"switches": [Switch(1.0, np.ones((3, 16)))]},
            r"switches\[0\]\.gains\.shape: \(3, 16\)",
        ),
        (
            {"switches": [Switch(1.0, PUBLISHED_GAINS), Switch(2.0, PUBLISHED_GAINS)]},
            r"switches\[1\]\.at_s: 2\.0 cannot be used; allowed: a finite number from 3\.0",
        ),
        ({"gains": MASKED}, "gains.*nan"),
        ({"gains": [PUBLISHED_GAINS, MASKED]}, r"gains\[1\].*nan"),
        (
            {
                "terrains": [terrain.flat()],
                "terrain_index": np.ma.masked_array([0, 0], [0, 1]),
            },
            "terrain_index.*whole numbers",
        ),
    ],
)
def test_bad_input_names_what_is_allowed(arguments, message):
    full = {
        "gains": [PUBLISHED_GAINS] * 2,
        "settings": CPU,
        **arguments,
    }
    with refused(message) as caught:
        taichi_nmm.simulate(**full)
    assert "allowed:" in str(caught.value)


ATTEMPT = """
import multiprocessing, threading, taichi_nmm
def walk():
    taichi_nmm.simulate(taichi_nmm.PUBLISHED_GAINS, duration_s=0.01)
def attempt():
    try:
        walk()
    except taichi_nmm.InputError as error:
        print(error, flush=True)
"""
THREAD = """
for _ in range(2):
    thread = threading.Thread(target=attempt, name="worker")
    thread.start()
    thread.join()
    walk()
print("done")
"""
FORK = """
walk()
child = multiprocessing.get_context("fork").Process(target=attempt)
child.start()
child.join(30)
child.kill()
"""


def test_first_simulation_off_the_main_thread_is_refused_and_later_ones_run():
    first, *others = printed("-c", ATTEMPT + THREAD).splitlines()
    assert first.startswith("thread: 'worker' cannot be used; allowed: the main thread")
    assert others == ["done"]


def test_simulation_in_a_fork_of_a_process_that_simulated_is_refused():
    """Taichi's threads do not survive a fork: the child would wait for them without end."""
    (line,) = printed("-c", ATTEMPT + FORK).splitlines()
    assert (
        line.startswith("process: ") and "multiprocessing.get_context('spawn')" in line
    )

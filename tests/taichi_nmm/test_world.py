"""Worlds: draws, refusals, and a world of its own for each walker."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from storage.inputs.config import Table
from study.pictures.stick_figure import leg
from taichi_nmm import PUBLISHED_GAINS, Settings, Worlds, simulate, terrain
from taichi_nmm.conditions import read_conditions
from taichi_nmm.kernel.muscle_table import (
    FMAX_N,
    MUSCLE_DATA,
    REFERENCE_STRAIN,
    unit_lengths,
)
from taichi_nmm.result import DELAYED
from taichi_nmm.world import NOMINAL, WorldRanges, read_world, require_begun
from tests.cases import cases, refused

ALL = WorldRanges(
    contact_stiffness=(0.3, 10.0),
    relaxation_speed=(0.5, 8.0),
    friction=(0.6, 1.0),
    strength=(0.8, 1.1),
    nerve_lag_s=(0.0, 0.01),
    sensing_noise=(0.0, 0.02),
    catch_ns=(0.0, 2.0),
)
CPU = Settings(arch="cpu", threads=1)


def test_the_nominal_world_is_the_published_one():
    worlds = Worlds.nominal(3)
    assert len(worlds) == 3
    assert np.all(worlds.contact_stiffness == 1.0) and np.all(
        worlds.relaxation_speed == 1.0
    )
    assert np.all(worlds.friction == 0.9)  # Geyer & Herr 2010
    assert worlds.strength.shape == (3, 14) and np.all(worlds.strength == 1.0)
    assert not np.any(worlds.nerve_lag_s) and not np.any(worlds.sensing_noise)
    drawn = NOMINAL.draw([7])
    for name, values in vars(worlds).items():
        assert name == "noise_seed" or np.array_equal(values[:1], getattr(drawn, name))


def assert_uniform(share):
    """Of 4,000 draws, from 0 to 1."""
    assert share.min() >= 0.0 and share.max() <= 1.0
    quarters = np.quantile(share, [0.25, 0.5, 0.75])
    np.testing.assert_allclose(
        quarters, [0.25, 0.5, 0.75], atol=5 * 0.5 / np.sqrt(4000)
    )


def test_draws_fill_their_ranges_by_the_documented_rule():
    worlds = ALL.draw(np.random.SeedSequence(3).spawn(4000))
    for values, (low, high) in (
        (np.log(worlds.contact_stiffness), np.log((0.3, 10.0))),
        (np.log(worlds.relaxation_speed), np.log((0.5, 8.0))),
        (worlds.friction, (0.6, 1.0)),
        (worlds.strength[:, 3], (0.8, 1.1)),
        (worlds.nerve_lag_s, (0.0, 0.01)),
        (worlds.sensing_noise, (0.0, 0.02)),
        (worlds.noise_seed, (0, 2**24)),
        (worlds.catch_ns, (0.0, 2.0)),
    ):
        assert_uniform((values - low) / (high - low))
    columns = np.column_stack([*list(vars(worlds).values())[:3], worlds.strength])
    related = np.abs(np.corrcoef(columns.T) - np.eye(columns.shape[1]))
    assert related.max() < 5 / np.sqrt(4000)


@pytest.mark.slow
def test_a_strength_that_all_muscles_share_multiplies_each_of_them():
    seeds = np.random.SeedSequence(3).spawn(4000)
    own = ALL.draw(seeds)
    both = replace(ALL, overall_strength=(0.7, 1.3)).draw(seeds)
    for name, values in vars(own).items():
        assert name == "strength" or np.array_equal(values, getattr(both, name))
    shared = both.strength / own.strength
    np.testing.assert_allclose(shared, np.repeat(shared[:, :1], 14, axis=1), rtol=1e-12)
    assert_uniform((shared[:, 0] - 0.7) / 0.6)
    assert abs(np.corrcoef(shared[:, 0], own.strength[:, 3])[0, 1]) < 5 / np.sqrt(4000)
    for overall in ((0.1, 1.0), (1.0, 9.0)):
        with refused(r"^world\.overall_strength: .*product of 0\.1 to 10$"):
            replace(ALL, strength=(0.5, 2.0), overall_strength=overall)


def test_a_seed_is_a_world_whatever_else_is_drawn_and_rows_are_taken_and_stacked():
    one, both = ALL.draw([5]), ALL.draw([4, 5])
    wider = replace(ALL, contact_stiffness=(0.3, 20.0)).draw([5])
    for name, values in vars(one).items():
        assert np.array_equal(values, getattr(both, name)[1:])
        same = np.array_equal(values, getattr(wider, name))
        assert same == (name != "contact_stiffness")
    worlds = ALL.draw([1, 2, 3])
    again = Worlds.stacked([worlds.take([0]), worlds.take([1, 2])])
    for name, values in vars(worlds).items():
        assert np.array_equal(values, getattr(again, name))


def test_the_table_reads_back_what_was_written():
    assert read_world(Table({})) == NOMINAL and NOMINAL.document() == {}
    again = read_back(**ALL.document())
    assert again == ALL and hash(again) == hash(ALL)
    assert list(WorldRanges(friction=(0.5, 0.5)).document()) == ["friction"]


@cases("bad-worlds.toml", "key", "value", "allowed")
def test_a_bad_table_is_named(key, value, allowed):
    with refused(rf"^world\.{key}[.\w]*: .* allowed: .*{allowed}"):
        read_world(Table({key: value}, "world"))


def read_back(**table):
    """The ranges of a table, which are those of their document and of their pickle."""
    ranges = read_world(Table(table))
    assert read_world(Table(ranges.document())) == ranges
    assert pickle.loads(pickle.dumps(ranges)) == ranges
    return ranges


def test_single_muscles_are_weak_or_missing():
    limp = read_back(strength=[0.5, 2.0], muscles={"SOL": 0.5, "GAS_right": 0})
    drawn, healthy = (
        each.draw([3, 4]) for each in (limp, WorldRanges(strength=(0.5, 2.0)))
    )
    factors = np.ones(14)
    factors[[0, 7, 9]] = 0.5, 0.5, 0.0
    assert np.array_equal(drawn.strength, healthy.strength * factors)
    assert limp.document()["muscles"] == {
        "SOL_left": 0.5,
        "SOL_right": 0.5,
        "GAS_right": 0.0,
    }
    with refused(r"world\.muscles\.HFL_right: .*0 to 5$"):
        read_world(
            Table({"strength": [0.5, 2.0], "muscles": {"HFL_right": 6.0}}, "world")
        )
    with refused(r"^world\.muscles: .* 14 numbers"):
        WorldRanges(muscles=(1.0, 0.5))


def test_a_prosthesis_takes_the_muscles_of_its_ankle():
    foot = {"side": "left", "stiffness_nmprad": 350, "damping_nmsprad": 1.0}
    drawn = read_back(muscles={"SOL": 0.5}, prosthesis=foot).draw([3, 4])
    assert drawn.prosthesis.tolist() == [[[350.0, 1.0, 0.0], [0.0] * 3]] * 2
    assert drawn.strength[0].tolist() == [0, 0, 0, 1, 1, 1, 1, 0.5, 1, 1, 1, 1, 1, 1]


def test_an_exoskeleton_helps_where_its_table_says():
    ranges = read_back(exoskeleton={"motion": "hip_flexion", "side": "right"})
    worn, none = [-1.0, 0.0, 0.0, 1e6], [0.0, 0.0, 0.0, 1e6]
    assert ranges.draw([3]).exoskeleton.tolist() == [[none, worn]]


def test_a_push_and_a_slip_come_once_and_before_the_walk_ends():
    push = {"time_s": 2.0, "duration_s": 0.1, "force_n": -150.0}
    slip = {"time_s": 3, "duration_s": 0.2, "friction": 0}
    worlds = read_back(push=push, slip=slip).draw([3, 4])
    assert worlds.push.tolist() == [[2.0, 0.1, -150.0]] * 2
    assert worlds.slip.tolist() == [[3.0, 0.2, 0.0]] * 2
    require_begun(worlds, 3.001)
    with refused(r"^world\.slip\.time_s: 3.* allowed: below 3, when the walk ends"):
        require_begun(worlds, 3.0)
    require_begun(NOMINAL.draw([3]), 0.001)
    with refused(r"^world\.slip: .*none with the engine mujoco"):
        read_world(Table({"slip": slip}, "world"), "mujoco")
    tables = {"world": {"push": push}, "simulation": {"duration_s": 2.0}}
    with refused(r"^world\.push\.time_s: 2.* below 2,"):
        read_conditions(Table(tables))


def test_muscles_have_lengths_and_times_of_their_own():
    table = {
        "slack_length": {"SOL": 1.05},
        "activation_time": {"TA_left": 2.0},
        "VAS": 0.5,
    }
    drawn = read_back(muscles=table).draw([3])
    assert drawn.slack_length[0].tolist() == ([1.05] + [1.0] * 6) * 2
    assert drawn.activation_time[0].tolist() == [1.0, 2.0, *[1.0] * 12]


@pytest.mark.slow
def test_recorded_fibres_leave_the_tendons_what_they_pull_with():
    """The force of a step is that of the pose before it, and of the fibre after it."""
    table = {
        "optimal_length": {"SOL": 1.2, "GLU_left": 0.9},
        "slack_length": {"TA": 1.02},
    }
    worlds = read_world(Table({"muscles": {"HAM_right": 0.5} | table})).draw([1])
    result = simulate(
        PUBLISHED_GAINS,
        duration_s=0.5,
        worlds=worlds,
        record=[0],
        record_rate_hz=1000.0,
        settings=CPU,
    )
    walk = result.trajectories[0]
    pose = walk.q - CPU.physics_step_s * walk.qdot
    joints = (pose[:, 3:] - pose[:, [2, 3, 4, 2, 6, 7]]).reshape(-1, 2, 3)
    lengths_m = np.array([[unit_lengths(*leg) for leg in legs] for legs in joints])
    slack_m = np.tile([data.slack_length_m for data in MUSCLE_DATA.values()], 2)
    slack_m = slack_m * worlds.slack_length[0]
    tendon_m = lengths_m.reshape(-1, 14) - walk.fibre_length_m
    strain = np.maximum(tendon_m / slack_m - 1.0, 0.0) / REFERENCE_STRAIN
    fmax_n = np.tile(FMAX_N, 2) * worlds.strength[0]
    np.testing.assert_allclose(
        fmax_n * strain**2, walk.muscle_force_n, atol=1e-3 * fmax_n.max()
    )
    speed = np.gradient(walk.fibre_length_m, walk.time_s, axis=0)
    assert (
        np.abs(np.median(speed[5:] / walk.fibre_velocity_mps[5:], axis=0) - 1.0).max()
        < 0.1
    )


@cases("bad-world-arrays.toml", "changed", "value", "named")
def test_bad_worlds_are_named(changed, value, named):
    with refused(f"^{named}: "):
        Worlds(**(vars(Worlds.nominal(2)) | {changed: value}))


def walk(worlds, count):
    gains = [PUBLISHED_GAINS] * count
    return simulate(
        gains, duration_s=3.0, terrains=terrain.rough(4), worlds=worlds, settings=CPU
    ).rows


@pytest.mark.slow
def test_each_walker_walks_in_its_own_world():
    worlds = ALL.draw(range(9))
    together = walk(worlds, 9)
    alone = [walk(worlds.take([row]), 1) for row in (0, 8)]
    assert together[0].tobytes() == alone[0].tobytes()
    assert together[8].tobytes() == alone[1].tobytes()
    assert len(np.unique(together["mean_speed_mps"])) == 9
    assert walk(Worlds.nominal(), 9).tobytes() == walk(None, 9).tobytes()
    with refused(r"^worlds: 2 cannot be used; allowed: one world, or 3"):
        walk(Worlds.nominal(2), 3)


# Neither is anything without the gains of a device, or noise.
NOT_ALONE = {"noise_seed", "exoskeleton"}


@pytest.mark.parametrize("name", sorted(vars(Worlds.nominal()).keys() - NOT_ALONE))
def test_every_number_reaches_the_walker(name):
    nominal = vars(Worlds.nominal())
    value = nominal[name] * 0.7 if np.any(nominal[name]) else nominal[name] + 0.01
    other = Worlds(**(nominal | {name: value}))
    assert walk(other, 1).tobytes() != walk(None, 1).tobytes()


def one_of(**changes):
    """A world that is nominal but for these changes."""
    return Worlds(
        **(vars(Worlds.nominal()) | {k: np.array([v]) for k, v in changes.items()})
    )


def recorded(duration_s=3.0, **changes):
    """Trajectory, of every tick, and row of the published gains on level ground in `one_of`."""
    result = simulate(
        PUBLISHED_GAINS,
        duration_s=duration_s,
        worlds=one_of(**changes),
        settings=CPU,
        record=[0],
        record_rate_hz=1000,
    )
    return result.trajectories[0], result.rows[0]


def test_friction_caps_the_horizontal_force():
    coefficient = 0.2
    across, up = recorded(friction=coefficient)[0].ground_force_n[:, [0, 1]].T
    loaded = up > 50.0
    ratio = np.abs(across[loaded]) / up[loaded]
    assert ratio.max() <= coefficient * 1.001
    assert np.mean(ratio > coefficient * 0.999) > 0.05  # it does slip


@pytest.mark.parametrize(
    ("stiffness", "relaxation"), [(1, 1), (0.4, 1), (4, 1), (1, 5)]
)
def test_the_ground_pushes_by_the_published_law(stiffness, relaxation):
    """Geyer & Herr 2010: k d (1 - u/vmax)+ a point, u outwards; k = M g / 1 cm, vmax 0.1 m/s."""
    walked, _ = recorded(contact_stiffness=stiffness, relaxation_speed=relaxation)
    left = leg(walked.q, 0)
    height_m = np.stack([left.heel[:, 1], left.ball[:, 1]])
    depth_m, speed_mps = (
        np.maximum(-height_m, 0.0),
        np.diff(height_m, axis=1, prepend=np.nan) * 1e3,
    )
    law = stiffness * 80.0 * 9.81 / 0.01 * depth_m
    law *= np.maximum(1.0 - speed_mps / (0.1 * relaxation), 0.0)
    up_n, law_n = walked.ground_force_n[:, 1], law.sum(axis=0)
    loaded = (up_n > 200.0) & np.isfinite(law_n)
    assert loaded.sum() > 500
    assert np.median(up_n[loaded] / law_n[loaded]) == pytest.approx(1.0, abs=0.02)
    assert np.mean(np.abs(up_n - law_n)[loaded] < 0.1 * up_n[loaded]) > 0.9


def test_half_the_muscle_pulls_and_burns_half():
    """In the first tick, before the body could move by it."""
    full, half = (
        recorded(1e-3, strength=np.full(14, strength)) for strength in (1.0, 0.5)
    )
    forces = [trajectory.muscle_force_n[-1] for trajectory, _ in (full, half)]
    assert forces[0].max() > 1.0
    np.testing.assert_allclose(forces[1], 0.5 * forces[0], rtol=1e-5)
    burnt = [float(row["cost_of_transport_jpkgpm"]) for _, row in (full, half)]
    assert burnt[1] == pytest.approx(0.5 * burnt[0], rel=1e-3)


def test_delayed_signals_were_recorded_earlier():
    walked, _ = recorded(1.5)
    forces = walked.muscle_force_n / np.tile(FMAX_N, 2)
    delayed = dict(zip(DELAYED, walked.delayed.T, strict=True))
    for ms, name, earlier in (
        (20, "r_delayed_SOL_force_fmax", forces[:, 7]),
        (10, "r_delayed_knee_flexion_rad", walked.joint_rad[:, 4]),
        # Found a tick after its pose is recorded.
        (9, "l_delayed_stance", walked.stance[:, 0]),
        (5, "l_delayed_GLU_force_fmax", forces[:, 5]),
        (5, "delayed_hat_rad", walked.q[:, 2]),
    ):
        assert earlier.max() > earlier.min()
        np.testing.assert_allclose(delayed[name][ms:], earlier[:-ms], atol=1e-6)


@pytest.mark.parametrize("change", [{"sensing_noise": 0.01}, {"catch_ns": 4.0}])
def test_noise_and_catches_are_of_their_walker_and_its_seed(change):
    own = [one_of(), *(one_of(**change, noise_seed=seed) for seed in (1.0, 1.0, 2.0))]
    alone = [walk(world, 1).tobytes() for world in own]
    assert len(set(alone)) == 3 and alone[1] == alone[2]
    assert [row.tobytes() for row in walk(Worlds.stacked(own), 4)] == alone


def test_nerves_feel_the_force_itself():
    """Positive force feedback of a muscle of half the strength starts from half the force."""
    weak, strong = (
        recorded(strength=np.full(14, strength))[0] for strength in (0.5, 1.0)
    )
    sol = [walked.activation[40:120, 0].mean() for walked in (weak, strong)]
    assert sol[0] < sol[1]

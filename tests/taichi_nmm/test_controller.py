"""`Controller`: refusals, and torques that depend on its own senses alone."""

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest

from taichi_nmm import Bodies, Controller, InputError, Observation, Settings, simulate
from taichi_nmm.parameters import PUBLISHED_GAINS, lower_bounds, upper_bounds
from tests.cases import refused

COUNT = 11  # two packs of eight lanes, one of them not full
STEPS = 60
NAMES = tuple(field.name for field in fields(Observation))
MUSCLES = ("activation", "stimulation", "length", "force_n")
FLOAT32 = Settings(precision="float32", arch="cpu")


def gains():
    rng = np.random.default_rng(2)
    drawn = rng.uniform(lower_bounds(), upper_bounds(), (COUNT - 1, 16))
    return np.vstack([PUBLISHED_GAINS, drawn])


def states():
    """Something that bodies may sense, other in each step."""
    rng = np.random.default_rng(1)
    return [
        Observation(
            joint_rad=rng.uniform(-0.1, 0.4, (COUNT, 6)),
            joint_rate_radps=rng.uniform(-1, 1, (COUNT, 6)),
            trunk_rad=rng.uniform(-0.1, 0.1, COUNT),
            trunk_rate_radps=rng.uniform(-0.5, 0.5, COUNT),
            contact=rng.random((COUNT, 2)) < 0.7,
            load_n=rng.uniform(0, 900, (COUNT, 2)),
            leg_length_m=rng.uniform(0.8, 1.0, (COUNT, 2)),
            leg_angle_rad=rng.uniform(1.2, 1.9, (COUNT, 2)),
            com_ahead_m=rng.uniform(-0.3, 0.3, (COUNT, 2)),
            com_speed_mps=rng.uniform(0.5, 1.5, COUNT),
        )
        for _ in range(STEPS)
    ]


def part(observation, rows):
    return Observation(
        *(np.asarray(getattr(observation, name))[rows] for name in NAMES)
    )


def torques(controller, observation):
    return np.array([controller.step(state) for state in observation])


@pytest.fixture(scope="module")
def undisturbed():
    """[steps, n, 6] of all controllers together."""
    return torques(Controller(gains(), settings=FLOAT32), states())


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"gains": np.zeros((2, 15))}, "gains"),
        ({"gains": np.full((2, 16), np.nan)}, r"gains\[0\]\.K_GAS"),
        (
            {"gains": np.tile(PUBLISHED_GAINS, (2, 1)), "bodies": Bodies.nominal(3)},
            "bodies",
        ),
        ({"gains": PUBLISHED_GAINS, "low_level_gains": [1.0]}, "low_level_gains"),
    ],
)
def test_arguments_that_cannot_be_used(arguments, field):
    with refused(field):
        Controller(arguments.pop("gains"), **arguments)


def test_muscles_before_the_first_step_and_rows_that_are_not_there():
    with refused(r"controller\.muscles: .* a first step"):
        _ = Controller(PUBLISHED_GAINS).muscles
    controller = Controller(gains())
    bad = [
        [-1],
        [COUNT],
        [[0]],
        [0.5],
        [True] * COUNT,
        3,
        ["a"],
        [[0], [1, 2]],
    ]
    for rows in bad:
        with refused(r"^rows: "):
            controller.keep(rows)
        assert len(controller) == COUNT


@pytest.mark.slow
def test_a_refused_step_leaves_no_trace(undisturbed):
    controller = Controller(gains(), settings=FLOAT32)
    found = []
    for number, state in enumerate(states()):
        for bad in (
            replace(state, trunk_rad=np.full(COUNT, np.nan)),
            replace(state, load_n=np.zeros((COUNT, 3))),
            replace(state, contact=["no"] * COUNT),
        ):
            with pytest.raises(InputError):
                controller.step(bad)
        if number:
            with pytest.raises(InputError):
                controller.keep([COUNT])
        found.append(controller.step(state))
    np.testing.assert_array_equal(found, undisturbed)


@pytest.mark.slow
def test_torques_do_not_depend_on_the_others(undisturbed):
    """Batch order and batch size; the last pack is full or not."""
    for rows in (np.arange(COUNT)[::-1], np.array([7, 2]), np.array([0]), np.arange(8)):
        controller = Controller(gains()[rows], settings=FLOAT32)
        found = torques(controller, [part(state, rows) for state in states()])
        np.testing.assert_array_equal(found, undisturbed[:, rows])


@pytest.mark.slow
@pytest.mark.parametrize("after", [STEPS // 2, 0])
@pytest.mark.parametrize("rows", [[10, 3, 3, 0], [4], np.arange(9), np.zeros(0, int)])
def test_those_who_are_kept_go_on(undisturbed, rows, after):
    """After some steps, or before the first."""
    controller = Controller(gains(), settings=FLOAT32)
    torques(controller, states()[:after])
    before = controller.muscles if after else None
    controller.keep(rows)
    assert len(controller) == len(rows)
    for name in MUSCLES if after else ():
        kept = getattr(before, name)[rows]
        np.testing.assert_array_equal(getattr(controller.muscles, name), kept)
    found = torques(controller, [part(state, rows) for state in states()[after:]])
    np.testing.assert_array_equal(found, undisturbed[after:, rows])


@pytest.mark.slow
def test_another_controller_and_simulation_between_change_nothing(undisturbed):
    """A simulation with other settings starts Taichi again: bound kernels are gone."""
    (controller, other_one), found = (
        (Controller(gains(), settings=FLOAT32) for _ in range(2)),
        [],
    )
    for number, state in enumerate(states()):
        found.append(controller.step(state))
        np.testing.assert_array_equal(other_one.step(state), undisturbed[number])
        if number == STEPS // 2:
            other = Settings(precision="float64", arch="cpu", physics_step_s=0.5e-3)
            simulate([PUBLISHED_GAINS], duration_s=0.01, settings=other)
    np.testing.assert_array_equal(found, undisturbed)


@pytest.mark.slow
def test_orders_come_every_millisecond():
    half = Controller(gains(), settings=replace(FLOAT32, physics_step_s=0.5e-3))
    orders = []
    for state in states():
        half.step(state)
        orders.append(half.muscles.stimulation)
    changed = [np.any(now != before) for before, now in pairwise(orders)]
    assert not any(changed[::2])  # from an even step to the next
    # Nerves take 5 ms and more: until then the orders are those of the first moment.
    assert all(changed[2 * 6 + 1 :: 2])


@pytest.mark.slow
def test_muscles_are_in_their_units():
    """Relaxed at first, within their ranges always; a force is one in N."""
    controller = Controller(gains(), settings=FLOAT32)
    for state in states():
        controller.step(state)
        muscles = controller.muscles
        assert all(getattr(muscles, name).shape == (COUNT, 14) for name in MUSCLES)
        for values in (muscles.activation, muscles.stimulation):
            assert values.min() >= 0.01 - 1e-7 and values.max() <= 1.0
        assert muscles.length.min() > 0.0
        assert muscles.force_n.min() >= 0.0
    assert muscles.force_n.max() > 50.0

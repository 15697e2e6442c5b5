"""The controller of a body that another simulator moves: senses in, joint torques out.

Muscles, delays, reflexes and swing-leg placement are the walker's own functions; only
their senses come from outside. The host launches `actuate`.
"""

from taichi_nmm.kernel import joints, kinematics, walker
from taichi_nmm.kernel.backend import Array, Rows, Static, named_rows, ti
from taichi_nmm.kernel.entry_points import (
    load,
    load_slots,
    load_table,
    save,
    save_slots,
)
from taichi_nmm.kernel.layout import (
    LEGS,
    SEGMENT_COUNT,
    Const,
    Muscle,
    Sense,
    State,
    WalkerRows,
    Work,
)


@ti.func
def step(
    tick,
    commands,
    activation_blend,
    load_blend,
    lanes: Static,
    muscles: Rows,
    senses: Rows,
    state: Rows,
    fibres: Rows,
    delay: Rows,
    const: Rows,
    work: Rows,
):
    """One physics step of the muscles, their orders being new where `commands` is 1."""
    for lane in range(lanes):
        take_in(lane, senses, state, work)
        kinematics.directions(lane, state, work)
        kinematics.joints(lane, state, work)
        joints.stretch_tendons(lane, work)
        walker.filter_loads(lane, load_blend, state, const)
    if commands == 1:
        walker.command(tick, lanes, state, fibres, delay, const, work)
    walker.contract_muscles(activation_blend, True, lanes, muscles, fibres, const, work)
    for lane in range(lanes):
        joints.turn_joints(lane, fibres, work)
        walker.add_ideal_torques(lane, state, const, work)


@ti.func
def take_in(lane, senses: Rows, state: Rows, work: Rows):
    """Put the senses into the rows that the walker's own functions read.

    These use the distance of the centre of mass from an ankle: here its position is
    zero.
    """
    for i in ti.static(range(SEGMENT_COUNT)):
        state.q[2 + i, lane] = senses.angle[i, lane]
        state.qdot[2 + i, lane] = senses.rate[i, lane]
    work.com_x[lane] = 0.0
    work.com_speed[lane] = senses.com_speed[lane]
    for leg in ti.static(range(LEGS)):
        state.touching[2 * leg, lane] = senses.contact[leg, lane]
        state.ground_force[2 * leg + 1, lane] = senses.load[leg, lane]
        work.leg_length[leg, lane] = senses.leg_length[leg, lane]
        work.leg_angle[leg, lane] = senses.leg_angle[leg, lane]
        work.ankle_x[leg, lane] = 0.0 - senses.com_ahead[leg, lane]


@ti.kernel
def actuate(
    lanes: Static,
    packs: Array,
    constants: Array,
    muscles: Array,
    sensed: Array,
    torques: Array,
    tick: int,
    commands: int,
    activation_blend: float,
    load_blend: float,
):
    """Joint torques of all packs for one physics step, N m.

    packs [p, WalkerRows.count, lane], constants [p, Const.count, lane], muscles [7,
    TABLE_COLUMNS], sensed [p, Sense.count, lane], torques [p, 6, lane].
    """
    ti.loop_config(serialize=True)  # waking a thread takes longer than the work
    for p in range(packs.shape[0]):
        work = named_rows(Work, lanes)
        table = load_table(muscles)
        state = load(packs, p, 0, State, lanes)
        fibres = load(packs, p, WalkerRows.fibres, Muscle, lanes)
        delay = load_slots(packs, p, tick, lanes)
        const = load(constants, p, 0, Const, lanes)
        senses = load(sensed, p, 0, Sense, lanes)
        step(
            tick,
            commands,
            activation_blend,
            load_blend,
            lanes,
            table,
            senses,
            state,
            fibres,
            delay,
            const,
            work,
        )
        save(packs, p, 0, lanes, state)
        save(packs, p, WalkerRows.fibres, lanes, fibres)
        save_slots(packs, p, tick, lanes, delay)
        for lane in range(lanes):
            for joint in ti.static(range(3 * LEGS)):
                torques[p, joint, lane] = work.joint_torque[joint, lane]

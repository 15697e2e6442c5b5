"""Walkers whose bodies another engine moves: the phases before and after that engine's step.

The same functions as in `walker.step`, less dynamics, contacts and joint stops. `drive`
gives the torques of a physics step, `follow` takes in where the bodies are after it.
"""

from taichi_nmm.kernel import contact, dynamics, gait, joints, walker
from taichi_nmm.kernel.backend import Array, Rows, Static, named_rows, ti
from taichi_nmm.kernel.entry_points import (
    load,
    load_slots,
    load_table,
    load_terrains,
    save,
    save_slots,
)
from taichi_nmm.kernel.layout import (
    COORDINATES,
    LEGS,
    MUSCLE_COUNT,
    Const,
    Drive,
    Gait,
    Motion,
    Muscle,
    State,
    Sums,
    WalkerRows,
    Work,
)


@ti.func
def before(
    tick,
    commands,
    activation_blend,
    lanes: Static,
    terrain: Rows,
    heights: Rows,
    muscles: Rows,
    state: Rows,
    fibres: Rows,
    delay: Rows,
    events: Rows,
    sums: Rows,
    const: Rows,
    work: Rows,
):
    """Senses, control where `commands` is 1, muscles: the joint torques of a physics step.

    The generalised force of catches and pushes is left at `Work.momentum`.
    """
    walker.locate(1, lanes, terrain, heights, state, work)
    for lane in range(lanes):
        contact.ground_heights(lane, work)
    if commands == 1:
        walker.control(tick, lanes, state, fibres, delay, events, sums, const, work)
    walker.contract_muscles(activation_blend, True, lanes, muscles, fibres, const, work)
    for lane in range(lanes):
        joints.turn_joints(lane, fibres, work)
        walker.add_ideal_torques(lane, state, const, work)
        gait.follow_torques(lane, events, work)
    for lane in range(lanes):
        for i in ti.static(range(COORDINATES)):
            work.momentum[i, lane] = 0.0
        dynamics.catch_feet(lane, tick, 1.0, const, work)
        dynamics.push_trunk(lane, tick, 1.0, const, work)


@ti.func
def after(
    tick,
    ends,
    step_s,
    load_blend,
    lanes: Static,
    drive_rows: Rows,
    motion: Rows,
    state: Rows,
    sums: Rows,
    const: Rows,
    work: Rows,
):
    """Positions, contacts and ground forces after the step; falls where `ends` is 1."""
    for lane in range(lanes):
        for i in ti.static(range(COORDINATES)):
            state.q[i, lane] = motion.q[i, lane]
            state.qdot[i, lane] = motion.qdot[i, lane]
        for leg in ti.static(range(LEGS)):
            state.touching[2 * leg, lane] = motion.touching[leg, lane]
        for i in ti.static(range(2 * LEGS)):
            state.ground_force[i, lane] = motion.ground_force[i, lane]
        work.metabolic_power[0, lane] = drive_rows.metabolic_power[lane]
        work.ground_hip[lane] = drive_rows.ground_hip[lane]
    for lane in range(lanes):
        walker.filter_loads(lane, load_blend, state, const)
        gait.add_up_forces(lane, step_s, state, sums, work)
    if ends == 1:
        for lane in range(lanes):
            walker.end_walk(lane, tick, state, work)


@ti.kernel
def drive(
    lanes: Static,
    packs: Array,
    constants: Array,
    terrains: Array,
    heights: Array,
    muscles: Array,
    drives: Array,
    tick: int,
    commands: int,
    activation_blend: float,
):
    """Torques on the bodies of all packs for a physics step: `drives` [p, Drive.count, lanes].

    packs [p, WalkerRows.count, lanes], constants [p, Const.count, lanes], terrains [p,
    lanes] (rows of `heights` [terrain, node]), muscles [7, TABLE_COLUMNS].
    """
    ti.loop_config(serialize=True)  # waking a thread takes longer than the work
    for p in range(packs.shape[0]):
        work = named_rows(Work, lanes)
        table = load_table(muscles)
        state = load(packs, p, 0, State, lanes)
        fibres = load(packs, p, WalkerRows.fibres, Muscle, lanes)
        delay = load_slots(packs, p, tick, lanes)
        events = load(packs, p, WalkerRows.events, Gait, lanes)
        sums = load(packs, p, WalkerRows.sums, Sums, lanes)
        const = load(constants, p, 0, Const, lanes)
        terrain = load_terrains(terrains, p, lanes)
        before(
            tick,
            commands,
            activation_blend,
            lanes,
            terrain,
            heights,
            table,
            state,
            fibres,
            delay,
            events,
            sums,
            const,
            work,
        )
        save(packs, p, 0, lanes, state)
        save(packs, p, WalkerRows.fibres, lanes, fibres)
        save_slots(packs, p, tick, lanes, delay)
        save(packs, p, WalkerRows.events, lanes, events)
        save(packs, p, WalkerRows.sums, lanes, sums)
        for lane in range(lanes):
            power_w = 0.0
            for m in ti.static(range(MUSCLE_COUNT)):
                power_w += work.metabolic_power[m, lane]
            for joint in ti.static(range(3 * LEGS)):
                drives[p, Drive.joint_torque + joint, lane] = work.joint_torque[
                    joint, lane
                ]
            drives[p, Drive.metabolic_power, lane] = power_w
            drives[p, Drive.ground_hip, lane] = work.ground_hip[lane]
            for i in ti.static(range(COORDINATES)):
                drives[p, Drive.push + i, lane] = work.momentum[i, lane]


@ti.kernel
def follow(
    lanes: Static,
    packs: Array,
    constants: Array,
    drives: Array,
    motions: Array,
    tick: int,
    ends: int,
    step_s: float,
    load_blend: float,
):
    """Take in where the bodies of all packs are after a physics step.

    packs [p, WalkerRows.count, lanes], constants [p, Const.count, lanes], drives as `drive`
    left them, motions [p, Motion.count, lanes].
    """
    ti.loop_config(serialize=True)  # waking a thread takes longer than the work
    for p in range(packs.shape[0]):
        work = named_rows(Work, lanes)
        state = load(packs, p, 0, State, lanes)
        sums = load(packs, p, WalkerRows.sums, Sums, lanes)
        const = load(constants, p, 0, Const, lanes)
        drive_rows = load(drives, p, 0, Drive, lanes)
        motion = load(motions, p, 0, Motion, lanes)
        after(
            tick,
            ends,
            step_s,
            load_blend,
            lanes,
            drive_rows,
            motion,
            state,
            sums,
            const,
            work,
        )
        save(packs, p, 0, lanes, state)
        save(packs, p, WalkerRows.sums, lanes, sums)

"""The time step of a pack of walkers, on one screen.

`step` is one control tick: sense, control, then as many physics steps as fit. Every
phase is a loop over the lanes whose body has no branch, so that the compiler turns it
into SIMD instructions. Times and delays are the same for all lanes, since a batch
starts together.
"""

from taichi_nmm.kernel import (
    contact,
    device,
    dynamics,
    gait,
    joints,
    kinematics,
    muscle,
    nerves,
    reflexes,
    swing,
)
from taichi_nmm.kernel.backend import Rows, Static, ti
from taichi_nmm.kernel.elementary import larger, latch
from taichi_nmm.kernel.layout import (
    COORDINATES,
    LEGS,
    MUSCLES_PER_LEG,
    RINGS,
)
from taichi_nmm.result import FALL_HEIGHT_M, FALL_LEAN_RAD

# The first solve and at most four more. The cap is part of the model: with fewer, or
# with many more, the verdict 'alive at 5 s' changes for some per cent of the search
# space.
CONTACT_PASSES = 1 + 4

LARGEST_SANE = 1e6  # a sum of |q| and |qdot| beyond this, or NaN, is a diverged walker
FELL, DIVERGED = 1.0, 2.0  # result.END_REASONS; 0 completes


@ti.func
def step(
    tick,
    substeps,
    step_s,
    activation_blend,
    load_blend,
    rough,
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
    """One control tick of 1 ms of all walkers in a pack: senses and control, then the physics."""
    # True if any lane needs the phase: it changes nothing of the lanes that do not.
    disturbed = highest(const.disturbed, lanes) > 0.0
    own = highest(const.own_muscles, lanes) > 0.0
    for substep in range(substeps):
        locate(rough, lanes, terrain, heights, state, work)
        for lane in range(lanes):
            contact.ground_heights(lane, work)
            contact.depths(lane, state, work)
        if substep == 0:
            control(tick, lanes, state, fibres, delay, events, sums, const, work)
        if own:
            contract_muscles(
                activation_blend, True, lanes, muscles, fibres, const, work
            )
        else:
            contract_muscles(
                activation_blend, False, lanes, muscles, fibres, const, work
            )
        for lane in range(lanes):
            joints.turn_joints(lane, fibres, work)
            add_ideal_torques(lane, state, const, work)
            gait.follow_torques(lane, events, work)
            joints.hip_stops(lane, work)
            contact.spring_forces(lane, step_s, state, const, work)
            joints.knee_and_ankle_stops(lane, step_s, work)
            dynamics.momentum_after_free_step(lane, step_s, 1.0, state, const, work)
        if disturbed:
            for lane in range(lanes):
                dynamics.catch_feet(lane, tick, step_s, const, work)
            for lane in range(lanes):
                dynamics.push_trunk(lane, tick, step_s, const, work)
        for _ in range(CONTACT_PASSES):
            for lane in range(lanes):
                dynamics.solve(lane, step_s, const, work)
                dynamics.revise_contacts(lane, const, work)
            # A further pass would change nothing.
            if highest(work.changed, lanes) == 0.0:
                break
        for lane in range(lanes):
            contact.drag_anchors(lane, step_s, state, const, work)
            contact.add_up_legs(lane, state, work)
            filter_loads(lane, load_blend, state, const)
            gait.add_up_forces(lane, step_s, state, sums, work)
            dynamics.step_coordinates(lane, step_s, state, work)
    for lane in range(lanes):
        end_walk(lane, tick, state, work)


@ti.func
def locate(rough, lanes: Static, terrain: Rows, heights: Rows, state: Rows, work: Rows):
    """Where the links, the joints and the tendons are, and the ground's heights below them."""
    for lane in range(lanes):
        kinematics.directions(lane, state, work)
        kinematics.contact_points(lane, state, work)
        contact.find_cells(lane, state, work)
        kinematics.joints(lane, state, work)
        joints.stretch_tendons(lane, work)
    if rough == 1:  # else all heights are and stay zero
        for lane in range(lanes):
            contact.read_terrain(lane, terrain[lane], heights, work)


@ti.func
def control(
    tick,
    lanes: Static,
    state: Rows,
    fibres: Rows,
    delay: Rows,
    events: Rows,
    sums: Rows,
    const: Rows,
    work: Rows,
):
    """Once a tick: note events of the gait, and give the muscles their orders."""
    real_tick = ti.cast(tick, float)
    for lane in range(lanes):
        kinematics.centre_of_mass(lane, state, const, work)
        for leg in ti.static(range(LEGS)):
            gait.notice(lane, leg, state, events, work)
    if highest(work.event, lanes) > 0.0:  # at most ticks, nobody's foot comes or goes
        for lane in range(lanes):
            for leg in ti.static(range(LEGS)):
                gait.note_events(lane, leg, real_tick, state, events, sums, work)
    for lane in range(lanes):
        for leg in ti.static(range(LEGS)):
            gait.follow_leg(lane, leg, real_tick, state, const, events, work)
        gait.add_up_posture(lane, state, fibres, sums, work)
        gait.add_up_motors(lane, state, sums, work)
    command(tick, lanes, state, fibres, delay, const, work)


@ti.func
def command(
    tick, lanes: Static, state: Rows, fibres: Rows, delay: Rows, const: Rows, work: Rows
):
    """Delayed senses, reflexes, swing-leg placement: stimulations and ideal torques of a tick."""
    real_tick = ti.cast(tick, float)
    for lane in range(lanes):
        nerves.sense(lane, state, fibres, work)
    # A ring length a loop, and a remainder that LLVM knows the range of: else it cannot
    # tell that the rows of different rings lie apart, and takes one lane after the
    # other.
    for ring in ti.static(range(len(RINGS))):
        slot = ti.raw_mod(tick, ti.static(RINGS[ring][2]))
        for lane in range(lanes):
            nerves.exchange(lane, ring, slot, delay, work)
    if nerves_vary(lanes, const):
        for lane in range(lanes):
            nerves.feel(lane, tick, state, const, work)
    for lane in range(lanes):
        reflexes.stance_weights(lane, state, work)
        reflexes.stimulate(lane, state, const, fibres, work)
        swing.leg_rates(lane, real_tick, state, const, work)
        swing.place_legs(lane, state, const, work)
    if highest(const.exo_torque, lanes) > 0.0:  # `assist` gives the others no torque
        for lane in range(lanes):
            device.assist(lane, state, const, work)


@ti.func
def highest(row: Rows, lanes: Static):
    """The largest number of a row over the lanes, 0 at least."""
    most = 0.0
    for lane in range(lanes):
        most = larger(most, row[lane])
    return most


@ti.func
def nerves_vary(lanes: Static, const: Rows):
    """Whether any lane has lag or noise; `nerves.feel` would change nothing of the others'."""
    vary = 0.0
    for lane in range(lanes):
        vary = larger(vary, 1.0 - const.nerve_blend[lane])
        vary = larger(vary, const.sensing_noise[lane])
    return vary > 0.0


@ti.func
def contract_muscles(
    blend,
    own: Static,
    lanes: Static,
    muscles: Rows,
    fibres: Rows,
    const: Rows,
    work: Rows,
):
    """All muscles, phase by phase. Run-time loops: their code is read from the nearest cache.

    `own` makes two codes, of muscles with the constants of the table and of muscles
    with their own.
    """
    for m in range(MUSCLES_PER_LEG):
        data = muscle.constants(muscles, m)
        for lane in range(lanes):
            muscle.activate(lane, m, data, blend, own, fibres, const, work)
    for _ in range(muscle.ITERATIONS):
        for m in range(MUSCLES_PER_LEG):
            data = muscle.constants(muscles, m)
            for lane in range(lanes):
                muscle.balance(lane, m, data, own, fibres, const, work)
    for m in range(MUSCLES_PER_LEG):
        data = muscle.constants(muscles, m)
        for lane in range(lanes):
            muscle.contract(lane, m, data, own, fibres, const, work)


@ti.func
def add_ideal_torques(lane, state: Rows, const: Rows, work: Rows):
    """Hip and knee torques: the muscles' by their share of stance, and the ideal parts.

    All joints get the torques of the devices.
    """
    for leg in ti.static(range(LEGS)):
        weight = state.stance_weight[leg, lane]
        hip, knee, ankle = ti.static(3 * leg, 3 * leg + 1, 3 * leg + 2)
        work.joint_torque[ankle, lane] += state.device_torque[
            ankle, lane
        ] + device.prosthesis_torque(lane, ankle, leg, const, work)
        work.joint_torque[hip, lane] = (
            weight * work.joint_torque[hip, lane]
            + state.hip_torque[leg, lane]
            + state.device_torque[hip, lane]
        )
        work.joint_torque[knee, lane] = (
            weight * work.joint_torque[knee, lane]
            + state.knee_torque[leg, lane]
            + state.device_torque[knee, lane]
        )


@ti.func
def filter_loads(lane, blend, state: Rows, const: Rows):
    """Low pass of the legs' ground forces. At the physics rate: a heel strike's spike
    is shorter than a tick, and aliasing it ruins the convergence with the step.
    """
    hat_weight = const.hat_weight[lane]
    for leg in ti.static(range(LEGS)):
        force_x = state.ground_force[2 * leg, lane]
        force_z = state.ground_force[2 * leg + 1, lane]
        load = larger((force_z - const.leg_weight[leg, lane]) / hat_weight, 0.0)
        state.load_filter[leg, lane] += blend * (load - state.load_filter[leg, lane])
        state.push_filter[leg, lane] += blend * (
            force_x / hat_weight - state.push_filter[leg, lane]
        )


@ti.func
def end_walk(lane, tick, state: Rows, work: Rows):
    """Fall and divergence; the place where an active walker is, so that a fallen one keeps its."""
    size = 0.0
    for rows in ti.static((state.q, state.qdot)):
        for i in ti.static(range(COORDINATES)):
            size += larger(rows[i, lane], 0.0 - rows[i, lane])
    diverged = (size < LARGEST_SANE) == False  # noqa: E712  (true for NaN too)
    lean = state.q[2, lane]
    upright = (
        (state.q[1, lane] - work.ground_hip[lane] >= FALL_HEIGHT_M)
        & (lean <= FALL_LEAN_RAD)
        & (lean >= 0.0 - FALL_LEAN_RAD)
    )
    active = state.active[lane] > 0.5
    ends = active & (diverged | (upright == False))  # noqa: E712
    reason = ti.select(diverged, DIVERGED, FELL)
    moves = active & (diverged == False)  # noqa: E712
    latch(state.end_reason, lane, ends, reason)
    latch(state.end_tick, lane, active, ti.cast(tick + 1, float))
    latch(state.end_x, lane, moves, state.q[0, lane])
    latch(state.end_z, lane, moves, state.q[1, lane])
    latch(state.active, lane, ends, 0.0)

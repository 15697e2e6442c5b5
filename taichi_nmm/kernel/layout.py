"""Where each named quantity lies in the kernels' local arrays [row, lane].

Legs are in the order left, right; contacts heel left, ball left, heel right, ball
right; joint stops knee left, ankle left, knee right, ankle right; muscles `MUSCLES`
left, then right; segments as in `body.SEGMENT_NAMES`. Kernels, the host and the tests
say `state.q[1, lane]`, where `state` are the named rows of a `Layout`.
"""

from typing import TYPE_CHECKING, Any

from taichi_nmm.parameters import DEVICE, FIXED, GAIN_NAMES

LEGS = 2
CONTACTS = 4
STOPS = 4
SEGMENT_COUNT = 7
MUSCLES_PER_LEG = 7
MUSCLE_COUNT = LEGS * MUSCLES_PER_LEG
COORDINATES = 9

SOL, TA, GAS, VAS, HAM, GLU, HFL = range(MUSCLES_PER_LEG)


class Layout:
    """Named blocks of rows of an array, one after another.

    `State.q` is the first row of a block, and `State.count` how many rows there are.
    `State.of(array).q` are the rows themselves: [row, lane], or [lane] of a single one.
    """

    def __init__(self, first: int = 0, /, **sizes: "int | Layout") -> None:
        """Blocks of these sizes from row `first` on; a block may have a layout of its own."""
        self.blocks = dict[str, tuple[int, int | Layout]]()
        for name, size in sizes.items():
            self.blocks[name] = first, size
            first += size if isinstance(size, int) else size.count
        self._settle(first)

    def _settle(self, count: int) -> None:
        self.count = count
        vars(self).update({name: first for name, (first, _) in self.blocks.items()})

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> int: ...

    def __or__(self, other: "Layout") -> "Layout":
        """Both, where rows may be the same."""
        both = Layout()
        both.blocks = self.blocks | other.blocks
        both._settle(max(self.count, other.count))
        return both

    def of(self, rows: Any) -> Any:
        """The rows of an array by name.

        Args:
            rows: [row, ...], of NumPy or local to a kernel.
        """
        return NamedRows(self, rows)


class NamedRows:
    """An array whose blocks of rows have names, of a `Layout`; also by number."""

    _data_oriented = True  # the compiler leaves an object of such a class as it is

    def __init__(self, layout: Layout, rows: Any) -> None:
        self.count = layout.count
        self._rows = rows
        for name, (first, size) in layout.blocks.items():
            if isinstance(size, Layout):
                block = size.of(rows[first : first + size.count])
            else:
                block = rows[first] if size == 1 else rows[first : first + size]
            setattr(self, name, block)

    def __getitem__(self, index: Any) -> Any:
        return self._rows[index]

    def __setitem__(self, index: Any, values: Any) -> None:
        self._rows[index] = values


# Signals that reach the controller late; a leg's two values lie side by side.
Signal = Layout(
    force_sol=LEGS,
    force_gas=LEGS,
    length_ta=LEGS,  # 20 ms
    force_vas=LEGS,
    knee=LEGS,
    knee_rate=LEGS,
    stance=LEGS,  # 10 ms
    force_ham=LEGS,
    force_glu=LEGS,
    load=LEGS,
    trunk=1,
    trunk_rate=1,  # 5 ms
)

# The state of a walker, from step to step.
State = Layout(
    q=COORDINATES,  # hip x, z; segment angles, clockwise positive
    qdot=COORDINATES,
    touching=CONTACTS,  # 1 while the point is in the ground
    anchor_x=CONTACTS,  # where the friction spring holds
    anchor_z=CONTACTS,
    load_filter=LEGS,  # leg load over HAT weight, 20 ms low pass
    push_filter=LEGS,  # horizontal ground force over HAT weight, 20 ms low pass
    ground_force=2 * LEGS,  # of the last physics step: left x, left z, right x, right z
    leg_angle_filter=LEGS,
    swing_phase=LEGS,  # FLEX, HOLD, STOP, EXTEND as 0..3
    leads=LEGS,  # the leg that came down last in this double support
    stance_before=LEGS,  # delayed stance flag at the last tick
    stance_weight=LEGS,  # share of stance control in the joint torques
    hip_torque=LEGS,  # ideal (muscle-free) part, held over the tick
    knee_torque=LEGS,
    active=1,  # 1 until the walker falls or diverges
    end_reason=1,
    end_tick=1,
    end_x=1,
    end_z=1,
    felt=Signal,  # behind the nerves' lag, at the last tick
    device_air=LEGS,  # ticks since the leg touched the ground
    device_clock=LEGS,  # ticks since the leg's last strike; 0 before the first
    device_stride=LEGS,  # ticks of its last stride; 0 before there was one
    device_torque=3 * LEGS,  # of an exoskeleton on hip, knee, ankle, held over the tick
)

Muscle = Layout(
    activation=MUSCLE_COUNT,
    stimulation=MUSCLE_COUNT,
    length=MUSCLE_COUNT,  # contractile element over its optimal length
    velocity=MUSCLE_COUNT,  # optimal lengths a second over the largest, lengthening positive
    force=MUSCLE_COUNT,  # over the nominal Fmax
)

# Never written by a step: each gain by its name (`const.K_SOL[leg, lane]`), coefficients
# of the body, and the world. A_i and B_ij multiply the directions of the links in the
# mass matrix: see `dynamics`.
Const = Layout(
    **dict.fromkeys(GAIN_NAMES, LEGS),
    strength=MUSCLE_COUNT,  # largest force over the nominal
    activation_blend=MUSCLE_COUNT,  # 1 - exp(-physics step / activation time)
    stretch=MUSCLE_COUNT,  # of the tendon over its reference, for an optimal length of the fibre
    tightness=MUSCLE_COUNT,  # the nominal slack length over the tendon's
    disturbed=1,  # 1 where there are catches, a push or a slip
    push_begin=1,  # tick, of a push on the trunk
    push_end=1,  # the first tick after it; 0: there is none
    push_n=1,
    slip_begin=1,  # likewise, of other friction
    slip_end=1,
    slip_friction=1,
    **dict.fromkeys((each.name for each in (*FIXED, *DEVICE)), 1),
    total_mass=1,  # kg
    a_hat=1,  # A of the HAT, kg m; negative, since its centre of mass lies above the hip
    b_hat=1,  # B of the HAT, kg m2
    a_leg=3 * LEGS,  # A1 A2 A3, kg m
    b_leg=6 * LEGS,  # B11 B22 B33 B12 B13 B23, kg m2
    contact_stiffness=1,  # N/m
    relaxation_speed=1,  # of a contact, m/s
    friction=1,  # Coulomb's coefficient
    own_muscles=1,  # 1 where the activation blend, stretch or tightness is not the nominal one
    nerve_blend=1,  # 1 - exp(-tick / lag); 1 without a lag
    sensing_noise=1,
    noise_seed=1,
    catch_ns=1,
    ankle_stiffness=LEGS,  # of a prosthesis, N m/rad; 0 is none
    ankle_damping=LEGS,  # N m s/rad
    ankle_rest=LEGS,  # angle without torque, rad
    exo_share=3 * LEGS,  # of an exoskeleton's torque on hip, knee and ankle
    exo_power=LEGS,  # its most, W
    hat_weight=1,  # N
    leg_weight=LEGS,  # N
    leg_angle_blend=1,  # 1 - exp(-w_filter tick)
)
PER_WALKER = Const.strength  # rows of the gains; walkers may share all others
LOW_LEVEL = Const.slip_friction + 1  # the first row of the low-level gains

# Scratch of one step. First comes what several of its parts use. After it lies what one
# part alone uses, in rows that the next part overwrites: the more rows, the longer a
# kernel compiles.
_shared = Layout(
    sine=SEGMENT_COUNT,
    cosine=SEGMENT_COUNT,
    point_x=CONTACTS,
    point_z=CONTACTS,
    height_left=CONTACTS + 1,  # of the ground at the ends of a cell (`cell`), m
    height_right=CONTACTS + 1,
    ground=CONTACTS,  # ground height under a contact point
    slope=CONTACTS,  # of the ground there
    ground_hip=1,
    depth=CONTACTS,  # in the ground, along its normal
    normal_x=CONTACTS,
    normal_z=CONTACTS,
    leg_length=LEGS,
    leg_angle=LEGS,
    ankle_x=LEGS,
    joint=3 * LEGS,  # hip, knee, ankle of the left leg, then the right
    joint_rate=3 * LEGS,
    joint_torque=3 * LEGS,
    sine_joint=2 * LEGS,  # knee, ankle
    cosine_joint=2 * LEGS,
    strain=MUSCLE_COUNT,  # of the tendon over its reference, before the fibre moves
    metabolic_power=MUSCLE_COUNT,  # W
)
_look_up = Layout(
    _shared.count,
    # Of the terrain's grid, under each contact point and under the hip.
    cell=CONTACTS + 1,
    along_cell=CONTACTS + 1,  # how far along it, 0 to 1
    slope_per_rise=CONTACTS + 1,  # 1/m; 0 outside of the grid
)
_control = Layout(
    _shared.count,
    com_x=1,
    com_z=1,
    com_speed=1,
    leg_angle_rate=LEGS,
    sensed=Signal,  # delayed signals
    strike=LEGS,  # 1 where the leg strikes the ground at this tick
    takeoff=LEGS,  # 1 where it has been in the air for long enough
    event=1,  # 1 where one of these is 1
)
_contraction = Layout(
    _shared.count,
    squeeze=MUSCLE_COUNT,  # root of the buffer's force, before the fibre moves
    slowest=MUSCLE_COUNT,  # range of the fibre's speed
    fastest=MUSCLE_COUNT,
    pull=MUSCLE_COUNT,  # the fibre's force over Fmax is (pull + pull_slope v)/(1 + hyperbola v)
    pull_slope=MUSCLE_COUNT,
    hyperbola=MUSCLE_COUNT,
)
_dynamics = Layout(
    _shared.count,
    momentum=COORDINATES,  # M qdot + h Q, without contacts
    normal_on=CONTACTS,  # 1 while the complementarity passes keep the contact
    slip=CONTACTS,  # 0 sticks; +-1 slips with friction of that sign
    normal_force=CONTACTS,
    friction=CONTACTS,
    normal_force_0=CONTACTS,  # at the old velocity; less the damping times the new one
    normal_damping=CONTACTS,
    friction_0=CONTACTS,
    friction_damping=1,
    grip=1,  # Coulomb's coefficient at this tick
    stop_on=STOPS,
    stop_torque_0=STOPS,
    stop_damping=STOPS,
    new_qdot=COORDINATES,
    changed=1,
)
Work = _shared | _look_up | _control | _contraction | _dynamics

LONG, MID = Signal.force_vas, Signal.force_ham - Signal.force_vas  # how many signals
SHORT = Signal.count - LONG - MID
# Each signal has a slot a tick.
Delay = Layout(long=20 * LONG, mid=10 * MID, short=5 * SHORT)
# Each kind of ring: its first signal, number of signals, ticks of delay, first row.
RINGS = (
    (0, LONG, 20, Delay.long),
    (LONG, MID, 10, Delay.mid),
    (LONG + MID, SHORT, 5, Delay.short),
)

# Observation of a body that another simulator moves (`kernel.actuation`).
Sense = Layout(
    angle=SEGMENT_COUNT,
    rate=SEGMENT_COUNT,
    contact=LEGS,
    load=LEGS,  # vertical ground force, N
    leg_length=LEGS,
    leg_angle=LEGS,
    com_ahead=LEGS,  # of each ankle, horizontally
    com_speed=1,
)

Pose = Layout(q=COORDINATES, qdot=COORDINATES)

# Input of another engine for a physics step, and its output (`carried`).
Drive = Layout(
    joint_torque=3 * LEGS,
    metabolic_power=1,  # W
    ground_hip=1,
    push=COORDINATES,  # generalised force of catches and pushes, N and N m
)
Motion = Layout(
    q=COORDINATES,
    qdot=COORDINATES,
    touching=LEGS,
    ground_force=2 * LEGS,
)

# Gait: the memory of a leg's step (`Gait`), and sums that the host drains (`Sums`).
Gait = Layout(
    in_stance=LEGS,
    struck=LEGS,  # this stance ended a swing seen from its take-off on, so its step is scored
    air_ticks=LEGS,
    knee_peak=LEGS,  # since the last contact
    knee_peak_swing=LEGS,  # of the swing before the strike
    knee_peak_stance=LEGS,
    ankle_strike=LEGS,
    ankle_last=LEGS,
    com_strike=LEGS,
    com_mid=LEGS,
    com_last=LEGS,
    past_middle=LEGS,
    trunk_sum=LEGS,
    hip_x_strike=LEGS,
    hip_x_last=LEGS,
    tick_strike=LEGS,
    tick_last=LEGS,
    vertical_peak=LEGS,
    braking_peak=LEGS,
    propulsion_peak=LEGS,
    # On hip, knee and ankle since the last take-off, of either sign, N m.
    torque_peak=3 * LEGS,
    tick_takeoff=LEGS,  # of the last committed take-off, for the event list
    last_strike_tick=1,  # of either leg
)

Sums = Layout(
    ticks=1,
    steps=1,
    m1=1,
    m2=1,
    m3=1,
    m4=1,
    m5=1,
    m5_corrected=1,
    knee_peak_swing=1,
    knee_peak_stance=1,
    ankle_strike=1,
    ankle_takeoff=1,
    vertical_peak=1,
    braking_peak=1,
    propulsion_peak=1,
    hip_torque_peak=1,
    knee_torque_peak=1,
    ankle_torque_peak=1,
    strikes=1,
    step_length=2,  # and of the square
    step_durations=1,
    step_duration=2,  # and of the square
    left_strikes=1,
    left_step_length=1,
    left_step_durations=1,
    left_step_duration=1,
    trunk=2,  # and of the square
    hip_height=2,  # and of the square
    hip_speed=2,  # and of the square
    double_support=1,
    flight=1,
    activation=MUSCLES_PER_LEG,
    activation_squared=1,
    activation_cubed=1,
    metabolic_energy=1,  # J
    motor_energy=1,  # positive work of ideal torques and exoskeleton, J
    impulse=2 * LEGS,  # ground force times time, N s: left x, left z, right x, right z
)

# What stays of a walker's state, as it lies there.
Ends = Layout(end_reason=1, end_tick=1, end_x=1, end_z=1)

# Rows of a walker between launches.
WalkerRows = Layout(state=State, fibres=Muscle, delay=Delay, events=Gait, sums=Sums)

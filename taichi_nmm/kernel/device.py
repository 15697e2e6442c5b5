"""Devices: an exoskeleton at hips, knees or ankles, and a passive foot in the place of an ankle.

The exoskeleton's torque follows the stride, timed by each leg's own heel strikes. It
rises to its peak and falls again on cubic splines, of which four numbers tell the
shape: peak torque, and peak time, rise and fall as shares of a stride (Zhang et al.
2017, "Human-in-the-loop optimization of exoskeleton assistance during walking", figure
1). A stride is taken to last as long as the one before; there is no torque before a
whole stride has been seen. A curve that would rise before the strike begins there.
Where the power at the joints would exceed the device's, all its torques are lowered
alike. The device has no mass of its own: [body.mass] may give the links some.

A prosthesis is a linear spring and damper (`world.Prosthesis`); the muscles that cross
the ankle are missing, their strength being 0.
"""

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.contact import on_ground
from taichi_nmm.kernel.elementary import larger, smaller
from taichi_nmm.kernel.gait import DEBOUNCE_TICKS
from taichi_nmm.kernel.layout import LEGS

LEAST_RATE_RADPS = 1e-3  # no torque at a slower rate has a power that is limited


@ti.func
def rising(share):
    """The spline from 0 to 1 whose slope is zero at both ends."""
    within = smaller(larger(share, 0.0), 1.0)
    return within * within * (3.0 - 2.0 * within)


@ti.func
def assist(lane, state: Rows, const: Rows, work: Rows):
    """The torques on the joints of each leg at this tick, N m, in the signs of the joints."""
    for leg in ti.static(range(LEGS)):
        down = on_ground(lane, leg, state) > 0.5
        strike = down & (state.device_air[leg, lane] >= DEBOUNCE_TICKS)
        # `before` are ticks since the last strike; 0 says that there was none.
        before = state.device_clock[leg, lane]
        stride = ti.select(strike, before, state.device_stride[leg, lane])
        clock = ti.select(strike, 1.0, ti.select(before > 0.0, before + 1.0, 0.0))
        share = clock / larger(stride, 1.0)
        from_peak = share - const.exo_peak[lane]
        up = rising(1.0 + from_peak / const.exo_rise[lane])
        down_again = rising(from_peak / const.exo_fall[lane])
        curve = const.exo_torque[lane] * up * (1.0 - down_again)
        torque = ti.select(stride > 0.0, curve, 0.0)
        rate = 0.0
        for joint in ti.static(range(3 * leg, 3 * leg + 3)):
            rate += const.exo_share[joint, lane] * work.joint_rate[joint, lane]
        most = const.exo_power[leg, lane]
        torque = ti.select(
            torque * rate > most, most / larger(rate, LEAST_RATE_RADPS), torque
        )
        for joint in ti.static(range(3 * leg, 3 * leg + 3)):
            state.device_torque[joint, lane] = const.exo_share[joint, lane] * torque
        state.device_stride[leg, lane] = stride
        state.device_clock[leg, lane] = clock
        air = state.device_air[leg, lane] + 1.0
        state.device_air[leg, lane] = ti.select(down, 0.0, air)


@ti.func
def prosthesis_torque(lane, ankle, leg, const: Rows, work: Rows):
    """Of the ankle's spring and damper, N m, plantarflexion positive: k (rest - angle) - c rate."""
    bent = const.ankle_rest[leg, lane] - work.joint[ankle, lane]
    rate = work.joint_rate[ankle, lane]
    return const.ankle_stiffness[leg, lane] * bent - (
        const.ankle_damping[leg, lane] * rate
    )

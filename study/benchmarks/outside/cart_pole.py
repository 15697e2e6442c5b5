"""Robotics: the gains of a controller that swings up a pole on a cart and balances it, in MuJoCo.

Energy is pumped into the pole (Astrom and Furuta 2000, Automatica 36) until it is nearly upright;
then a linear law balances it. The cheap run is short, of the body as drawn, at a coarse time step.
The costly ones are long, of four bodies that were not: other masses, friction, a late motor.
"""

from dataclasses import dataclass
from functools import cache
from math import cos, hypot, pi, sin
from typing import Any

import mujoco
import numpy as np
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from study.benchmarks.outside.definition import Definition, Feature, Settings

GRAVITY_MPS2 = 9.81
CART_KG, POLE_KG, HALF_POLE_M = 1.0, 0.2, 0.5
TRACK_M = 3.0  # to each side
MOTOR_N = 15.0
CONTROL_S = 0.01
COARSE_STEP_S, FINE_STEP_S = 0.01, 0.005
SHORT_S, LONG_S = 6.0, 12.0
UPRIGHT_RAD = 0.2

SPACE = {
    "law": CategoricalDistribution(("proportional", "bang-bang", "saturated")),
    "pump": FloatDistribution(2.0, 50.0, log=True),  # N a joule of energy missing
    "centring": FloatDistribution(0.3, 10.0, log=True),  # N/m while pumping
    "catch": FloatDistribution(0.1, 1.0),  # rad from upright where balancing begins
    "angle": FloatDistribution(10.0, 200.0, log=True),  # N/rad
    "rate": FloatDistribution(1.0, 40.0, log=True),  # N s/rad
    "place": FloatDistribution(0.3, 15.0, log=True),  # N/m, and as many N s/m
    "hold": IntDistribution(1, 5),  # control periods between two commands
}


@dataclass(frozen=True)
class Body:
    """What is driven: factors of what was drawn, and how many control periods the motor is late."""

    cart: float = 1.0
    pole: float = 1.0
    cart_friction: float = 0.1  # N s/m
    joint_friction: float = 0.002  # N m s/rad
    late: int = 0


DRAWN = Body()
BUILT = (
    Body(1.2, 0.9, 0.6, 0.006, 0),
    Body(0.9, 1.3, 0.2, 0.004, 1),
    Body(1.1, 1.6, 1.0, 0.010, 0),
    Body(1.3, 1.1, 0.4, 0.002, 1),
)


@dataclass(frozen=True)
class Swing:
    """What a run showed.

    Attributes:
        upright_s: when the pole was first near upright; infinite: never.
        standing: share of the run in which it was.
        mean_error: of 1 - cos of the angle from upright, halved, and of the cart's place, over the
            run: 0 is a pole that stands in the middle all the time.
        farthest_m: of the cart from the middle.
        effort: mean square of the force, N^2.
    """

    upright_s: float
    standing: float
    mean_error: float
    farthest_m: float
    effort: float


def cheap(settings: Settings) -> tuple[float, ...]:
    """When first and how long upright, error, farthest place and effort of the short run."""
    swing = _swing(settings, DRAWN, SHORT_S, COARSE_STEP_S)
    return swing.upright_s, swing.standing, swing.mean_error, swing.farthest_m, swing.effort


def costly(settings: Settings) -> float:
    """Mean error of the long runs of the bodies as built."""
    errors = [_swing(settings, body, LONG_S, FINE_STEP_S).mean_error for body in BUILT]
    return float(np.mean(errors))


def _swing(settings: Settings, body: Body, duration_s: float, step_s: float) -> Swing:
    """One run from a pole that hangs down."""
    model, data = _model(body, step_s)
    mujoco.mj_resetData(model, data)
    data.qpos[1] = pi - 0.02
    controls = round(duration_s / CONTROL_S)
    steps = round(CONTROL_S / step_s)
    waiting = [0.0] * (body.late + 1)  # forces under way
    upright_s, standing, error, farthest, effort, force = float("inf"), 0, 0.0, 0.0, 0.0, 0.0
    for control in range(controls):
        (place, angle), (speed, rate) = data.qpos.tolist(), data.qvel.tolist()
        if control % int(settings["hold"]) == 0:
            force = _force(settings, place, angle, speed, rate)
        waiting.append(force)
        data.ctrl[0] = waiting.pop(0)
        mujoco.mj_step(model, data, steps)
        bent = hypot(sin(angle), 1.0 - cos(angle)) / 2.0  # 0 upright, 1 hanging
        error += bent + (place / TRACK_M) ** 2
        farthest = max(farthest, abs(place))
        effort += force**2
        if abs(sin(angle)) < sin(UPRIGHT_RAD) and cos(angle) > 0.0:
            upright_s = min(upright_s, control * CONTROL_S)
            standing += 1
    return Swing(upright_s, standing / controls, error / controls, farthest, effort / controls)


def _force(settings: Settings, place: float, angle: float, speed: float, rate: float) -> float:
    """The motor's force for a state, N."""
    from_upright = (angle + pi) % (2.0 * pi) - pi
    if abs(from_upright) < float(settings["catch"]):
        force = (
            float(settings["angle"]) * from_upright
            + float(settings["rate"]) * rate
            + float(settings["place"]) * (place + speed)
        )
        return min(max(force, -MOTOR_N), MOTOR_N)
    inertia = POLE_KG * HALF_POLE_M**2 * 4.0 / 3.0
    energy = 0.5 * inertia * rate**2 + POLE_KG * GRAVITY_MPS2 * HALF_POLE_M * (cos(angle) - 1.0)
    pumped = float(settings["pump"]) * -energy
    direction = rate * cos(angle)
    if settings["law"] == "proportional":
        force = pumped * direction
    elif settings["law"] == "bang-bang":
        force = MOTOR_N * _sign(direction) * _sign(-energy)
    else:
        force = min(max(pumped, -MOTOR_N), MOTOR_N) * _sign(direction)
    force = -force - float(settings["centring"]) * place
    return min(max(force, -MOTOR_N), MOTOR_N)


def _sign(value: float) -> float:
    return float(value > 0.0) - float(value < 0.0)


@cache
def _model(body: Body, step_s: float) -> tuple[Any, Any]:
    """The compiled body, and a state of it."""
    text = f"""
    <mujoco>
      <option timestep="{step_s}" integrator="RK4" gravity="0 0 -{GRAVITY_MPS2}"/>
      <worldbody>
        <body>
          <joint name="track" type="slide" axis="1 0 0" limited="true" range="-{TRACK_M} {TRACK_M}"
                 damping="{body.cart_friction}"/>
          <geom type="box" size=".1 .05 .05" mass="{CART_KG * body.cart}" contype="0"/>
          <body>
            <joint type="hinge" axis="0 1 0" damping="{body.joint_friction}"/>
            <geom type="capsule" fromto="0 0 0 0 0 {2.0 * HALF_POLE_M}" size=".01"
                  mass="{POLE_KG * body.pole}" contype="0"/>
          </body>
        </body>
      </worldbody>
      <actuator>
        <motor joint="track" ctrllimited="true" ctrlrange="-{MOTOR_N} {MOTOR_N}"/>
      </actuator>
    </mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


DEFINITION = Definition(
    name="cart-pole",
    purpose="reported",
    field="robotics",
    cost_meaning="error of angle and place over 12 s, mean of four bodies; 0: stands in the middle",
    space=SPACE,
    features={
        "upright_s": Feature("low", "when the pole is first upright, s; infinite: not within 6 s"),
        "standing": Feature("high", "share of these 6 s in which it is"),
        "error": Feature("low", "error of angle and place over these 6 s"),
        "farthest_m": Feature("low", "of the cart from the middle, m"),
        "effort": Feature("low", "mean square of the force, N^2"),
    },
    cheap=cheap,
    costly=costly,
)

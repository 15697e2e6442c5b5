"""Stance reflexes and their mixing with swing: muscle stimulations and weights of the torques.

Sources: stance reflexes Geyer & Herr 2010; mixing by leg load after Song & Geyer 2015,
as in the walker T. All signals are the delayed ones.
"""

import math

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.elementary import larger, smaller
from taichi_nmm.kernel.layout import (
    GAS,
    GLU,
    HAM,
    HFL,
    LEGS,
    MUSCLES_PER_LEG,
    SOL,
    TA,
    VAS,
)

PRESTIMULATION = 0.01
PRESTIMULATION_VAS = 0.08
PRESTIMULATION_TRUNK = 0.05
OVEREXTENSION_RAD = math.radians(10.0)
LOAD_FILTER_S = 0.02


@ti.func
def clip01(x):
    """x limited to [0, 1]."""
    return smaller(larger(x, 0.0), 1.0)


@ti.func
def stance_weights(lane, state: Rows, work: Rows):
    """Share of stance control of each leg, from stance flags, load, and which leg came down last.

    0 off the ground; the load while the other leg leads in double support; else 1.
    """
    sensed = work.sensed
    both = sensed.stance[0, lane] * sensed.stance[1, lane]
    for leg in ti.static(range(LEGS)):
        flag = sensed.stance[leg, lane]
        rises = both * ti.select(flag > state.stance_before[leg, lane], 1.0, 0.0)
        state.leads[leg, lane] = both * larger(state.leads[leg, lane], rises)
        state.stance_before[leg, lane] = flag
    for leg in ti.static(range(LEGS)):
        flag = sensed.stance[leg, lane]
        load = clip01(sensed.load[leg, lane])
        other_leads = state.leads[1 - leg, lane]
        state.stance_weight[leg, lane] = flag * ti.select(other_leads > 0.5, load, 1.0)


@ti.func
def stimulate(lane, state: Rows, const: Rows, muscle: Rows, work: Rows):
    """Stimulations of all muscles: stance reflexes and swing, mixed by the stance weights."""
    sensed = work.sensed
    lean = sensed.trunk[lane] - const.theta_ref[lane]
    lean_rate = sensed.trunk_rate[lane]
    for leg in ti.static(range(LEGS)):
        weight = state.stance_weight[leg, lane]
        load = sensed.load[leg, lane]
        force_sol = sensed.force_sol[leg, lane]
        force_gas = sensed.force_gas[leg, lane]
        length_ta = sensed.length_ta[leg, lane]
        knee = sensed.knee[leg, lane]
        extends = (knee < OVEREXTENSION_RAD) & (sensed.knee_rate[leg, lane] < 0.0)
        inhibition = const.k_oe[lane] * ti.select(
            extends, OVEREXTENSION_RAD - knee, 0.0
        )
        balance = (
            const.Kp_stance[leg, lane] * lean + const.Kd_stance[leg, lane] * lean_rate
        )
        # Forward lean excites the extensors, backward lean the flexor, as the leg
        # carries load.
        extensor = clip01(load * (PRESTIMULATION_TRUNK + larger(balance, 0.0)))
        flexor = clip01(load * (PRESTIMULATION_TRUNK - smaller(balance, 0.0)))
        swing_ta = PRESTIMULATION + const.K_TA[leg, lane] * length_ta
        sol = PRESTIMULATION + const.K_SOL[leg, lane] * force_sol
        ta = swing_ta - const.K_TA_SOL[leg, lane] * force_sol
        gas = PRESTIMULATION + const.K_GAS[leg, lane] * force_gas
        vas = (
            PRESTIMULATION_VAS
            + const.K_VAS[leg, lane] * sensed.force_vas[leg, lane]
            - inhibition
        )
        ham = (
            PRESTIMULATION
            + const.K_HAM[leg, lane] * sensed.force_ham[leg, lane]
            + extensor
        )
        glu = (
            PRESTIMULATION
            + const.K_GLU[leg, lane] * sensed.force_glu[leg, lane]
            + const.K_mix_GLU[leg, lane] * extensor
        )
        first = ti.static(MUSCLES_PER_LEG * leg)
        muscle.stimulation[first + SOL, lane] = mix(weight, sol, 0.0)
        muscle.stimulation[first + TA, lane] = mix(weight, ta, swing_ta)
        muscle.stimulation[first + GAS, lane] = mix(weight, gas, 0.0)
        muscle.stimulation[first + VAS, lane] = mix(weight, vas, 0.0)
        muscle.stimulation[first + HAM, lane] = mix(weight, ham, 0.0)
        muscle.stimulation[first + GLU, lane] = mix(weight, glu, 0.0)
        muscle.stimulation[first + HFL, lane] = mix(weight, flexor, 0.0)


@ti.func
def mix(weight, stance, swing):
    """Stimulation between stance and swing, within [0.01, 1]."""
    return smaller(
        larger(weight * stance + (1.0 - weight) * swing, PRESTIMULATION), 1.0
    )

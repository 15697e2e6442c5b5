"""Feet on the ground: height under each point, depth, and the springs' forces at the old velocity.

Normal force kn d (1 - u/vmax)+ as Geyer & Herr 2010; friction an anchored spring and
damper, capped by one Coulomb coefficient. Both enter the step linearly implicitly
(`dynamics`).
"""

from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M
from taichi_nmm.kernel.backend import Rows, Static, ti
from taichi_nmm.kernel.dynamics import point_velocity
from taichi_nmm.kernel.elementary import larger, latch, smaller, square_root
from taichi_nmm.kernel.layout import CONTACTS, LEGS
from taichi_nmm.terrain import GRID_NODES, GRID_SPACING_M, GRID_START_M

# Geyer & Herr 2010: kn = M g / this; kt the same, as in the walker T.
STATIC_DEFLECTION_M = 0.01
# ct = this times kt; ours, for the anchored spring (docs/walker.md).
FRICTION_DAMPING_S = 0.02

LAST_CELL = float(GRID_NODES - 2)
ANKLE_SHARE_OF_BALL = -HEEL_OFFSET_M / (BALL_OFFSET_M - HEEL_OFFSET_M)


@ti.func
def find_cells(lane, state: Rows, work: Rows):
    """Cells of the terrain's grid under the four contact points and the hip."""
    for p in ti.static(range(CONTACTS)):
        find_cell(lane, p, work.point_x[p, lane], work)
    find_cell(lane, CONTACTS, state.q[0, lane], work)


@ti.func
def find_cell(lane, p: Static, x, work: Rows):
    """The cell that holds x is that of point p; the ground is level outside of the grid."""
    cell = (x - GRID_START_M) * (1.0 / GRID_SPACING_M)
    # NaN becomes 0, since the cell becomes an index.
    clamped = smaller(larger(0.0, cell), LAST_CELL + 1.0)
    left = smaller(ti.floor(clamped), LAST_CELL)
    work.cell[p, lane] = left
    work.along_cell[p, lane] = clamped - left
    work.slope_per_rise[p, lane] = ti.select(cell == clamped, 1.0 / GRID_SPACING_M, 0.0)


@ti.func
def read_terrain(lane, index, heights: Rows, work: Rows):
    """Heights of terrain `index` at the ends of the cells; the only phase that reads it.

    Reading takes one lane after the other, so nothing else is done here.
    """
    for p in ti.static(range(CONTACTS + 1)):
        i = ti.cast(work.cell[p, lane], ti.i32)
        work.height_left[p, lane] = heights[index, i]
        work.height_right[p, lane] = heights[index, i + 1]


@ti.func
def ground_under(lane, p: Static, work: Rows):
    """Height and slope of the ground at point p: linear between nodes."""
    low = work.height_left[p, lane]
    rise = work.height_right[p, lane] - low
    return low + rise * work.along_cell[p, lane], rise * work.slope_per_rise[p, lane]


@ti.func
def ground_heights(lane, work: Rows):
    """Height of the ground under hip and contact points, and its slope under the latter."""
    height_hip, _slope_hip = ground_under(lane, CONTACTS, work)
    work.ground_hip[lane] = height_hip
    for c in ti.static(range(CONTACTS)):
        height, slope = ground_under(lane, c, work)
        work.ground[c, lane] = height
        work.slope[c, lane] = slope


@ti.func
def depths(lane, state: Rows, work: Rows):
    """How deep each point is, along the ground's normal; a fresh touch-down sets the anchor."""
    for c in ti.static(range(CONTACTS)):
        height, slope = work.ground[c, lane], work.slope[c, lane]
        cosine = 1.0 / square_root(1.0 + slope * slope)
        depth = (height - work.point_z[c, lane]) * cosine
        work.depth[c, lane] = depth
        work.normal_x[c, lane] = 0.0 - slope * cosine
        work.normal_z[c, lane] = cosine
        touching = ti.select(depth > 0.0, 1.0, 0.0)
        fresh = touching > state.touching[c, lane]
        latch(state.anchor_x[c], lane, fresh, work.point_x[c, lane])
        latch(state.anchor_z[c], lane, fresh, work.point_z[c, lane])
        state.touching[c, lane] = touching


@ti.func
def spring_forces(lane, step_s, state: Rows, const: Rows, work: Rows):
    """Contact forces at zero velocity and their damping by the new one, c = k d/vmax + k h.

    Every touching point starts the complementarity passes as sticking.
    """
    stiffness = const.contact_stiffness[lane]
    relaxation_speed_mps = const.relaxation_speed[lane]
    work.friction_damping[lane] = stiffness * (FRICTION_DAMPING_S + step_s)
    work.grip[lane] = const.friction[lane]
    for c in ti.static(range(CONTACTS)):
        tangent_x = work.normal_z[c, lane]
        tangent_z = 0.0 - work.normal_x[c, lane]
        slid = (work.point_x[c, lane] - state.anchor_x[c, lane]) * tangent_x + (
            work.point_z[c, lane] - state.anchor_z[c, lane]
        ) * tangent_z
        work.normal_force_0[c, lane] = stiffness * work.depth[c, lane]
        work.normal_damping[c, lane] = stiffness * (
            work.depth[c, lane] / relaxation_speed_mps + step_s
        )
        work.friction_0[c, lane] = 0.0 - stiffness * slid
        work.normal_on[c, lane] = state.touching[c, lane]
        work.slip[c, lane] = 0.0
        work.normal_force[c, lane] = 0.0
        work.friction[c, lane] = 0.0


@ti.func
def drag_anchors(lane, step_s, state: Rows, const: Rows, work: Rows):
    """A point that slips, or has let go, takes its anchor along: the spring holds what is left."""
    stiffness = const.contact_stiffness[lane]
    for c in ti.static(range(CONTACTS)):
        tangent_x = work.normal_z[c, lane]
        tangent_z = 0.0 - work.normal_x[c, lane]
        speed_x, speed_z = point_velocity(lane, c, work)
        hold = work.friction[c, lane] / stiffness
        new_x = work.point_x[c, lane] + step_s * speed_x + tangent_x * hold
        new_z = work.point_z[c, lane] + step_s * speed_z + tangent_z * hold
        slips = (work.slip[c, lane] != 0.0) | (work.normal_on[c, lane] == 0.0)
        latch(state.anchor_x[c], lane, slips, new_x)
        latch(state.anchor_z[c], lane, slips, new_z)


@ti.func
def add_up_legs(lane, state: Rows, work: Rows):
    """Ground force x, z of each leg: of its heel and ball together."""
    for leg in ti.static(range(LEGS)):
        force_x = 0.0
        force_z = 0.0
        for end in ti.static(range(2)):
            c = ti.static(2 * leg + end)
            normal, friction = (
                work.normal_force[c, lane],
                work.friction[c, lane],
            )
            nx, nz = work.normal_x[c, lane], work.normal_z[c, lane]
            force_x += normal * nx + friction * nz
            force_z += normal * nz - friction * nx
        state.ground_force[2 * leg, lane] = force_x
        state.ground_force[2 * leg + 1, lane] = force_z


@ti.func
def ground_at_ankle(lane, leg: Static, work: Rows):
    """Ground height under the ankle, from those under heel and ball."""
    heel = work.ground[2 * leg, lane]
    ball = work.ground[2 * leg + 1, lane]
    return heel + ANKLE_SHARE_OF_BALL * (ball - heel)


@ti.func
def on_ground(lane, leg: Static, state: Rows):
    """1 while heel or ball of the leg is in the ground, else 0."""
    return larger(state.touching[2 * leg, lane], state.touching[2 * leg + 1, lane])

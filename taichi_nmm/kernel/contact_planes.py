"""Planes under the soles of walkers whose bodies another engine moves: the ground where each is.

A sole is a sphere. What it touches is the nearest point of the height table, or two in
a hollow, with the line from there to its centre as normal; the plane through that point
is the ground until the next step. Solids side by side would not do: a sphere that has
sunk in where two of them meet touches the end of the one that it has left, and is
pushed along the ground.

All in float64, whatever the controller's precision: a stiff contact sinks in by
hundredths of a millimetre, hundreds of metres from where the ground begins.
"""

from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M, SHANK_LENGTH_M, THIGH_LENGTH_M
from taichi_nmm.kernel.backend import Array, Static, ti
from taichi_nmm.kernel.elementary import larger, smaller
from taichi_nmm.kernel.layout import CONTACTS
from taichi_nmm.terrain import GRID_SPACING_M

SOLE_RADIUS_M = 0.01
PLANES_PER_SOLE = 2
# Planes lie in the order of the soles: heel and ball, left, then right.
PLANES = PLANES_PER_SOLE * CONTACTS

UNUSED_M = 1.0  # under a sole's centre a level plane supports nothing
NOWHERE_M = 1e30  # farther than any ground


@ti.kernel
def lay_planes(
    count: int,
    index: Array,
    nodes: Array,
    heights: Array,
    qpos: Array,
    positions: Array,
    quaternions: Array,
):
    """The planes under the soles of the first `count` walkers.

    index [n] (rows of heights), nodes [k], heights [terrain, k], qpos [n, 9],
    positions [n, PLANES, 3], quaternions [n, PLANES, 4].
    """
    ti.loop_config(serialize=True)  # waking a thread takes longer than the work
    for w in range(count):
        for sole in ti.static(range(CONTACTS)):
            x, z = sole_centre(w, sole, qpos)
            first, second = nearest_points(x, z, index[w], nodes, heights)
            lay(w, PLANES_PER_SOLE * sole, first, positions, quaternions)
            lay(w, PLANES_PER_SOLE * sole + 1, second, positions, quaternions)


@ti.func
def sole_centre(w, sole: Static, qpos: Array):
    """Where the centre of a sole is, by the angles of MuJoCo's hinges (`linkage`)."""
    hip = ti.static(3 + 3 * (sole // 2))
    offset = ti.static((HEEL_OFFSET_M, BALL_OFFSET_M)[sole % 2])
    thigh = qpos[w, 2] + qpos[w, hip]
    shank = thigh + qpos[w, hip + 1]
    foot = shank + qpos[w, hip + 2]
    sine, cosine = ti.sin(foot), ti.cos(foot)
    x = (
        qpos[w, 0]
        - ti.f64(THIGH_LENGTH_M) * ti.sin(thigh)
        - ti.f64(SHANK_LENGTH_M) * ti.sin(shank)
        + ti.f64(offset) * cosine
        + ti.f64(SOLE_RADIUS_M) * sine
    )
    z = (
        qpos[w, 1]
        - ti.f64(THIGH_LENGTH_M) * ti.cos(thigh)
        - ti.f64(SHANK_LENGTH_M) * ti.cos(shank)
        - ti.f64(offset) * sine
        + ti.f64(SOLE_RADIUS_M) * cosine
    )
    return x, z


@ti.func
def nearest_points(x, z, ground, nodes: Array, heights: Array):
    """The two points of the ground that carry a sole at x, z: distance, x, z, normal x, z of each.

    They are local minima of the distance, on a piece between two nodes or at a node
    that stands out; of the piece under x and those beside it, since no sole reaches
    farther. From within the ground the least deep one is the way out, and others hold
    only what is above them.
    """
    zero = ti.f64(0.0)
    cell = cell_under(x, nodes)
    share = (x - nodes[cell]) / (nodes[cell + 1] - nodes[cell])
    rise = heights[ground, cell + 1] - heights[ground, cell]
    below = z < heights[ground, cell] + share * rise
    unused = ti.Vector(
        [zero + ti.f64(NOWHERE_M), x, z - ti.f64(UNUSED_M), zero, zero + 1.0]
    )
    first, second, way_out = unused, unused, unused
    before = zero  # where along the piece before the nearest point lies: at its end from 1 on
    for shift in ti.static(range(-1, 2)):
        piece = cell + shift
        if piece >= 0 and piece < nodes.shape[0] - 1:
            from_x, from_z = x - nodes[piece], z - heights[ground, piece]
            dx = nodes[piece + 1] - nodes[piece]
            dz = heights[ground, piece + 1] - heights[ground, piece]
            length = ti.sqrt(dx * dx + dz * dz)
            along = (from_x * dx + from_z * dz) / (length * length)
            distance, normal_x, normal_z = zero + ti.f64(NOWHERE_M), zero, zero + 1.0
            if along > 0.0 and along < 1.0:
                normal_x, normal_z = 0.0 - dz / length, dx / length
                distance = from_x * normal_x + from_z * normal_z
            elif along <= 0.0 and before >= 1.0:
                distance = ti.sqrt(from_x * from_x + from_z * from_z)
                if below:
                    distance = 0.0 - distance
                if distance != 0.0:
                    normal_x, normal_z = from_x / distance, from_z / distance
            before = along
            point = ti.Vector(
                [
                    distance,
                    x - distance * normal_x,
                    z - distance * normal_z,
                    normal_x,
                    normal_z,
                ]
            )
            if distance < 0.0:
                if 0.0 - distance < ti.abs(way_out[0]):
                    way_out = point
            elif distance < first[0]:
                second = first
                first = point
            elif distance < second[0]:
                second = point
    if below and way_out[0] < 0.0:
        second = first
        first = way_out
    return first, second


@ti.func
def cell_under(x, nodes: Array):
    """The piece of the ground under x: the aprons are the first and the last; 0 for no number."""
    zero = ti.f64(0.0)
    along = (x - nodes[1]) / ti.f64(GRID_SPACING_M) + 1.0
    return ti.cast(
        ti.floor(smaller(larger(zero, along), zero + (nodes.shape[0] - 2))), ti.i32
    )


@ti.func
def lay(w, plane: Static, point, positions: Array, quaternions: Array):
    """Put a plane through a point of the ground, turned about y from z to its normal."""
    positions[w, plane, 0] = point[1]
    positions[w, plane, 2] = point[2]
    half_cosine = ti.sqrt(0.5 * (1.0 + point[4]))
    quaternions[w, plane, 0] = half_cosine
    quaternions[w, plane, 2] = 0.5 * point[3] / half_cosine

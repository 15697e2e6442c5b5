"""What the numbers of a world change in a MuJoCo model, and which models they cannot change.

A number means the same on any model, or `reason_against` says why it has no meaning on
this one. docs/robots.md has the table; `tests/storage/test_odd_models.py` measures it.
"""

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROUGH_CELL_M = 0.2
ROUGH_LENGTH_M, ROUGH_WIDTH_M = 80.0, 20.0  # its middle is below the start
LEVEL_M = 1.0  # around the start, where rough ground is level
BASE_M = 1.0  # of rough ground below its lowest place
# cosine: a plane that faces up or along x by more than this is said to do so
FACING = 0.7
LEAST_REACTION = 1e-15  # by which MuJoCo divides: its mjMINVAL
EXACT = 1e-6  # of a direction or a height that has to be right

# What a factor scales in a model: fields by name, and which part of each. The first of
# each was all that version 0.3.0 knew.
FACTORS: dict[str, dict[str, Any]] = {
    "friction": {  # of sliding; that of turning and rolling is in m
        "geom_friction": np.s_[:, :1],
        "pair_friction": np.s_[:, :2],
        "flex_friction": np.s_[:, :1],
    },
    "damping": {
        "dof_damping": np.s_[:],
        "dof_dampingpoly": np.s_[:],
        "tendon_damping": np.s_[:],
        "tendon_dampingpoly": np.s_[:],
        "actuator_damping": np.s_[:],
        "actuator_dampingpoly": np.s_[:],
    },
    "armature": {
        "dof_armature": np.s_[:],
        "tendon_armature": np.s_[:],
        "actuator_armature": np.s_[:],
    },
}


def gravity_of(model: Any) -> Floats:
    """Of a model, [3] in m/s2; zeros where it is switched off."""
    import mujoco

    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
        return np.zeros(3)
    return np.array(model.opt.gravity, dtype=np.float64)


def upward(model: Any) -> tuple[int, float]:
    """The axis, 1 or 2, and the sign of the direction in which heights are measured.

    It is z, or y in a model whose gravity is along y. Runs go along x.
    """
    gravity = gravity_of(model)
    axis = 1 if abs(gravity[1]) > abs(gravity[2]) else 2
    return axis, -1.0 if gravity[axis] > 0.0 else 1.0


def chain_of(model: Any, root: int) -> list[int]:
    """Bodies from the world's child down to this one."""
    chain = list[int]()
    while root:
        chain.insert(0, root)
        root = int(model.body_parentid[root])
    return chain


def joints_of(model: Any, root: int) -> list[int]:
    """Joints that move a body, from the world's down."""
    return [
        int(model.body_jntadr[body]) + place
        for body in chain_of(model, root)
        for place in range(model.body_jntnum[body])
    ]


def push_rates(model: Any, root: int) -> Floats | None:
    """Velocities [nv] that move the root along x at 1 m/s and do not turn it, or None.

    They are those of a free joint, or of slides that no hinge turns: others lie
    elsewhere later.
    """
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rates, slides = np.zeros(model.nv), list[int]()
    for joint in joints_of(model, root):
        kind = model.jnt_type[joint]
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            rates[model.jnt_dofadr[joint]] = 1.0
            return rates
        if kind != mujoco.mjtJoint.mjJNT_SLIDE:
            break
        slides.append(joint)
    if not slides:
        return None
    axes = data.xaxis[slides].T
    along_x = np.array([1.0, 0.0, 0.0])
    found = np.linalg.lstsq(axes, along_x, rcond=None)[0].round(12)
    if np.abs(axes @ found - along_x).max() > EXACT:
        return None
    rates[model.jnt_dofadr[slides]] = found
    return rates


def quaternions(model: Any) -> list[int]:
    """Places in `qpos` where an orientation of 4 numbers begins."""
    import mujoco

    free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    ball = model.jnt_type == mujoco.mjtJoint.mjJNT_BALL
    return [*(model.jnt_qposadr[free] + 3).tolist(), *model.jnt_qposadr[ball].tolist()]


def weight_of(model: Any, root: int) -> float:
    """In N, of the bodies that move with the root: of those that joints connect with it."""
    mass = np.where(moves_with(model, root), model.body_mass, 0.0).sum()
    return float(mass * np.linalg.norm(gravity_of(model)))


def moves_with(model: Any, root: int) -> NDArray[np.bool_]:
    """Which bodies are of the root's tree, [nbody]: not the rail or the table that carries it.

    Nothing moves a fixed root: of such a model these are all bodies that hang on what
    carries it.
    """
    if model.body_treeid[root] >= 0:
        return np.asarray(model.body_treeid == model.body_treeid[root])
    return np.asarray(model.body_rootid == model.body_rootid[root])


def change(model: Any, world: Mapping[str, float], draws: np.random.Generator) -> None:
    """Change a model as the numbers of a world say, all but the ground and what is in a run."""
    import mujoco

    _fix_muscles(model)
    spread = 1.0 + world["mass_spread"] * draws.uniform(-1.0, 1.0, model.nbody)
    model.body_mass[:] *= world["mass"] * spread
    model.body_inertia[:] *= (world["mass"] * world["inertia"] * spread)[:, None]
    for number, fields in FACTORS.items():
        for name, part in fields.items():
            getattr(model, name)[part] *= world[number]
    # of all contacts, where a model overrides theirs
    model.opt.o_friction[:2] *= world["friction"]
    _strengthen(model, world["strength"])
    _lean(model, world["slope"])
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _fix_muscles(model: Any) -> None:
    """Write down forces that MuJoCo derives from masses: a heavier body is no stronger one."""
    for muscle in _derived_muscles(model):
        reaction = max(
            model.actuator_acc0[model.actuator_outadr[muscle]], LEAST_REACTION
        )
        for parameters in (model.actuator_gainprm, model.actuator_biasprm):
            parameters[muscle, 2] = parameters[muscle, 3] / reaction


def _derived_muscles(model: Any) -> list[int]:
    """Muscles whose peak force follows from the acceleration that it gives, as MuJoCo's default."""
    import mujoco

    is_muscle = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_MUSCLE
    derived = is_muscle & (model.actuator_gainprm[:, 2] < 0.0)
    return [int(k) for k in np.flatnonzero(derived)]


def _strengthen(model: Any, strength: float) -> None:
    """Scale what each actuator gives at any control and state, and all limits of it.

    A force is gain x control + bias: both are scaled, so that a servo gets softer as it
    gets weaker. Of a muscle, numbers 2 and 3 are forces.
    """
    import mujoco

    gains = (
        model.actuator_gainprm,
        model.actuator_gaintype == mujoco.mjtGain.mjGAIN_MUSCLE,
    )
    biases = (
        model.actuator_biasprm,
        model.actuator_biastype == mujoco.mjtBias.mjBIAS_MUSCLE,
    )
    for parameters, is_muscle in (gains, biases):
        parameters[~is_muscle, :3] *= strength
        parameters[is_muscle, 2:4] *= strength
    for limits in (
        model.actuator_forcerange,
        model.jnt_actfrcrange,
        model.tendon_actfrcrange,
    ):
        limits[:] *= strength


def _lean(model: Any, slope: float) -> None:
    """Turn gravity towards -x: the ground stays as it is, and rises along x."""
    if slope == 0.0:
        return
    gravity = gravity_of(model)
    down = np.linalg.norm(gravity)
    up = -gravity / down
    forwards = np.array([1.0, 0.0, 0.0]) - up[0] * up
    forwards /= np.linalg.norm(forwards)
    turn = np.arctan(slope)
    model.opt.gravity[:] = -down * np.sin(turn) * forwards - down * np.cos(turn) * up


def reason_against(model: Any, root: int, start: Floats, number: str) -> str:
    """Why a number of a world has no meaning for a model; empty where it has one.

    Args:
        model: the compiled model of the base setting.
        root: number of its root body.
        start: place of the root at the start, [3] in m.
        number: a name of `WORLDS`.
    """
    if number == "strength":
        return _against_strength(model)
    if number == "inertia" and _drags_by_inertia(model):
        return "its fluid takes the shapes of bodies from their inertias"
    if number == "push_mps" and push_rates(model, root) is None:
        return (
            f"nothing moves its root, {_name(model, root)}, along x without turning it"
        )
    if number == "rough_m":
        return _against_rough(model, start)
    if number == "slope":
        across = np.linalg.norm(gravity_of(model)[1:])
        if not gravity_of(model).any():
            return "it has no gravity"
        if across < EXACT:
            return "its gravity is along x"
    return ""


def reason_against_default_fall(model: Any, root: int, start: Floats) -> str:
    """Why half of the root's height is no sign of a fall in this model; empty where it is one."""
    axis, sign = upward(model)
    name = _name(model, root)
    if not joints_of(model, root):
        return f"its root, {name}, is fixed"
    if sign * start[axis] <= 0.0:
        return f"its root, {name}, starts at a height of {sign * start[axis]:g} m"
    for place, turn in _grounds(model):
        if abs(sign * turn[axis, 2] - 1.0) > EXACT:
            return "its ground is not level"
        if abs(place[axis]) > EXACT:
            return f"its ground is at a height of {sign * place[axis]:g} m"
    return ""


def numerics_of(model: Any, root: int, start: Floats) -> bytes:
    """Of the version of a model's runs: b"1" where they are bit by bit those of 0.3.0."""
    import mujoco

    gravity, rates = gravity_of(model), push_rates(model, root)
    later = [name for fields in FACTORS.values() for name in list(fields)[1:]]
    overrides = model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE
    limited = (
        model.actuator_forcelimited,
        model.jnt_actfrclimited,
        model.tendon_actfrclimited,
    )
    differs = (
        any(np.any(getattr(model, name)) for name in later)
        or any(np.any(each) for each in limited)
        or bool(overrides)
        or bool(_derived_muscles(model))
        or bool(quaternions(model))
        or bool(gravity[0] or gravity[1] or gravity[2] >= 0.0)
        or (rates is not None and rates.tolist() != [1.0, *[0.0] * (model.nv - 1)])
        or bool(np.any(model.body_mass[~moves_with(model, root)]))
        or any(
            place[0] != start[0] or place[1] != start[1] or turn[2, 2] != 1.0
            for place, turn in _grounds(model)
        )
    )
    return b"2" if differs else b"1"


def _against_strength(model: Any) -> str:
    import mujoco

    gain, bias = mujoco.mjtGain, mujoco.mjtBias
    gains = [gain.mjGAIN_FIXED, gain.mjGAIN_AFFINE, gain.mjGAIN_MUSCLE, gain.mjGAIN_SO3]
    biases = [bias.mjBIAS_NONE, bias.mjBIAS_AFFINE, bias.mjBIAS_MUSCLE, bias.mjBIAS_SO3]
    for k in range(model.nactuator):
        name = model.actuator(k).name or k
        if model.actuator_plugin[k] >= 0:
            return f"its actuator {name} is a plugin"
        forward = int(model.actuator_ctrlspec[k]) & int(mujoco.mjtCtrlInput.mjINPUT_FF)
        is_pid = model.actuator_gaintype[k] == gain.mjGAIN_PID and not forward
        is_known = is_pid or np.any(
            model.actuator_gaintype[k] == np.array(gains, dtype=int)
        )
        if not is_known or np.all(
            model.actuator_biastype[k] != np.array(biases, dtype=int)
        ):
            return f"the force of its actuator {name} cannot be scaled as a whole"
    return ""


def _drags_by_inertia(model: Any) -> bool:
    """Whether a fluid's force on a body is that on the box of the same inertia."""
    if not (model.opt.density > 0.0 or model.opt.viscosity > 0.0):
        return False
    with_shapes = set(model.geom_bodyid[model.geom_fluid[:, 0] > 0.0].tolist())
    moving = np.flatnonzero(model.body_weldid > 0)
    return any(int(body) not in with_shapes for body in moving)


def _name(model: Any, body: int) -> str:
    return model.body(body).name or f"body {body}"


def _posed(model: Any) -> Any:
    """The model as its file has it."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data


def _is_ground(model: Any, geom: int, turn: Floats) -> bool:
    """Whether a geom is a fixed plane that faces up, and that something can touch."""
    import mujoco

    axis, sign = upward(model)
    in_pairs = geom in model.pair_geom1 or geom in model.pair_geom2
    return bool(
        model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        and model.body_weldid[model.geom_bodyid[geom]] == 0
        and sign * turn[axis, 2] > FACING
        and (model.geom_contype[geom] or model.geom_conaffinity[geom] or in_pairs)
    )


def _grounds(model: Any) -> list[tuple[Floats, Floats]]:
    """Places [3] and turns [3, 3] of all planes that are ground."""
    data = _posed(model)
    turns = data.geom_xmat.reshape(-1, 3, 3)
    return [
        (data.geom_xpos[geom], turns[geom])
        for geom in range(model.ngeom)
        if _is_ground(model, geom, turns[geom])
    ]


def _touches(model: Any, ground: int) -> bool:
    """Whether a geom that moves can touch this one."""
    moving = np.flatnonzero(model.body_weldid[model.geom_bodyid] > 0)
    paired = {*zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)}
    for geom in moving:
        asks = model.geom_contype[geom] & model.geom_conaffinity[ground]
        asked = model.geom_contype[ground] & model.geom_conaffinity[geom]
        if asks or asked or {(ground, geom), (geom, ground)} & paired:
            return True
    return bool(model.nflex)


def _below(model: Any, start: Floats) -> int:
    """The fixed geom that lies below the start, or -1."""
    import mujoco

    bare = copy.copy(model)  # a ray passes what cannot be seen
    moving = model.body_weldid[model.geom_bodyid] > 0
    passed = moving | ((model.geom_contype | model.geom_conaffinity) == 0)
    for pair in (model.pair_geom1, model.pair_geom2):
        passed[pair[~moving[pair]]] = False
    bare.geom_matid[:] = -1
    bare.geom_rgba[:, 3] = np.where(passed, 0.0, 1.0)
    # they have no end
    bare.geom_size[bare.geom_type == mujoco.mjtGeom.mjGEOM_PLANE] = 0.0
    axis, sign = upward(model)
    down = np.zeros(3)
    down[axis] = -sign
    found = np.array([-1], dtype=np.int32)
    mujoco.mj_ray(bare, _posed(bare), start, down, None, 1, -1, found)
    return int(found[0])


def _against_rough(model: Any, start: Floats) -> str:
    import mujoco

    turns = _posed(model).geom_xmat.reshape(-1, 3, 3)
    grounds = [
        geom for geom in range(model.ngeom) if _is_ground(model, geom, turns[geom])
    ]
    if len(grounds) != 1:
        return f"it has {len(grounds)} planes as its ground, and rough ground replaces one plane"
    (ground,) = grounds
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return "its contacts are switched off"
    if not _touches(model, ground):
        return "nothing of it touches its ground"
    if turns[ground][0, 0] < FACING:
        return "its ground, one plane, is turned about its normal"
    if _below(model, start) != ground:
        return "another thing than its ground, one plane, lies below its root"
    return ""


def roughen(
    spec: Any, start: Floats, amplitude_m: float, draws: np.random.Generator
) -> str:
    """Put a height field in the place of the ground, a plane of the world.

    Args:
        spec: of a model of which `reason_against` has nothing against rough ground; it
            is changed.
        start: place of the root at the start, [3] in m.
        amplitude_m: from the lowest place to the highest.
        draws: of the heights.

    Returns:
        Why it cannot be done, or nothing.
    """
    import mujoco

    plain = spec.compile()  # which gives geoms their numbers
    data = _posed(plain)
    turns = data.geom_xmat.reshape(-1, 3, 3)
    number = next(k for k in range(plain.ngeom) if _is_ground(plain, k, turns[k]))
    ground = next(geom for geom in spec.geoms if geom.id == number)
    if ground.frame is not None:
        return "its ground, one plane, is within a frame"
    along = round(ROUGH_LENGTH_M / ROUGH_CELL_M) + 1
    across = round(ROUGH_WIDTH_M / ROUGH_CELL_M) + 1
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, along) * ROUGH_LENGTH_M,
        np.linspace(-0.5, 0.5, across) * ROUGH_WIDTH_M,
    )
    heights = draws.random((across, along))
    heights[np.maximum(np.abs(x), np.abs(y)) <= LEVEL_M] = 0.5
    spec.add_hfield(
        name="rough_ground",
        nrow=across,
        ncol=along,
        userdata=heights.ravel(),
        size=[ROUGH_LENGTH_M / 2, ROUGH_WIDTH_M / 2, amplitude_m, BASE_M],
    )
    ground.type = mujoco.mjtGeom.mjGEOM_HFIELD
    ground.hfieldname = "rough_ground"
    normal = turns[number][:, 2]
    aside = start - data.geom_xpos[number]
    aside = aside - (aside @ normal) * normal
    body = data.xmat[plain.geom_bodyid[number]].reshape(3, 3)
    ground.pos = ground.pos + body.T @ (aside - 0.5 * amplitude_m * normal)
    return ""

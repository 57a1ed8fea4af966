"""MJX for a scene: `mjx.step` with the collision detection of `manifold`, and an exact line search.

Tracing MJX unrolls its collision routines over all pairs of geoms, which takes minutes for convex
pieces. In this module, one routine processes the nearest pairs of geoms and fills MJX's contacts.
Kinematics, constraints and integrator are those of MJX.

The constraints are solved by Newton's method. The accelerations minimize a convex function that is
quadratic between breakpoints, at which constraints activate or deactivate (MuJoCo's documentation,
Computation, "Primal problem"). Along a line, the slope of this function is piecewise linear. MJX
brackets the zero of the slope in some 64 passes over the constraint rows, which takes a third of a
step's time on a GPU. This module evaluates the slope at all breakpoints at once. The zero between
two breakpoints is then exact.
"""

import contextlib
import copy
import io
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..errors import EngineError
from .derived import invweights
from .layout import Layout, Poses
from .manifold import (
    PAIR_CONTACTS,
    GeomPairs,
    PosedSolid,
    Solids,
    geom_pairs,
    geom_solids,
    manifolds,
)
from .model import CompiledScene, SceneModel
from .model_fields import model_fields

MjxState = Any
"""An `mjx.Data` of MJX's JAX implementation. Only this module imports MJX, which prints."""
LONGEST_STEP = 100.0
"""Distance, in Newton steps, beyond which breakpoints are ignored."""


class Rows(NamedTuple):
    """Constraint rows; the force at residual acceleration x is `-clip(D * x, low, high)`."""

    jacobian: Float[Array, "row nv"]
    target: Float[Array, " row"]
    """Reference accelerations."""
    stiffness: Float[Array, " row"]
    """D, the inverse of the regularized inertia along the row."""
    low: Float[Array, " row"]
    high: Float[Array, " row"]


def constraint_rows(d: MjxState) -> Rows:
    """Return the constraint rows (efc) of a step.

    They are equality constraints, friction loss, limits and pyramidal contacts, in this order.
    """
    impl = d._impl
    count = impl.efc_D.shape[0]
    k = jnp.arange(count)
    equality, friction = k < impl.ne, (k >= impl.ne) & (k < impl.ne + impl.nf)
    low = jnp.where(friction, -impl.efc_frictionloss, -jnp.inf)
    high = jnp.where(equality, jnp.inf, jnp.where(friction, impl.efc_frictionloss, 0.0))
    return Rows(impl.efc_J, impl.efc_aref, impl.efc_D, low, high)


def solve(d: MjxState, iterations: int) -> MjxState:
    """Solve for the accelerations and constraint forces of a step.

    Returns:
        Data with `qacc`, `qfrc_constraint` and `efc_force`.
    """
    rows, impl = constraint_rows(d), d._impl
    qacc, force = newton(rows, impl.M, d.qfrc_smooth, d.qacc_warmstart, iterations)
    constraint = rows.jacobian.T @ force
    return d.replace(qacc=qacc, qfrc_constraint=constraint, _impl=impl.replace(efc_force=force))


def newton(
    rows: Rows,
    inertia: Float[Array, "nv nv"],
    smooth: Float[Array, " nv"],
    start: Float[Array, " nv"],
    iterations: int,
) -> tuple[Float[Array, " nv"], Float[Array, " row"]]:
    """Minimize the primal function of MuJoCo's constraints over accelerations.

    Returns:
        Accelerations, and the forces of the rows.
    """

    def step(_: Any, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        qacc, weight, residual = carry
        push = _row_forces(rows, residual)
        excess = rows.stiffness * residual - push
        active = jnp.where(excess == 0, rows.stiffness, 0.0)
        gradient = weight - smooth + rows.jacobian.T @ push
        hessian = inertia + (rows.jacobian.T * active) @ rows.jacobian
        factor = jax.scipy.linalg.cho_factor((hessian + hessian.T) / 2)
        direction = -jax.scipy.linalg.cho_solve(factor, gradient)
        weight_change = inertia @ direction
        residual_change = rows.jacobian @ direction
        # Forces relative to the start of the line avoid cancellation.
        ends = jnp.stack([rows.low, rows.high]) - push
        slope, curvature = jnp.dot(gradient, direction), jnp.dot(direction, weight_change)
        length = exact_step(ends, excess, rows.stiffness, residual_change, slope, curvature)
        return (
            qacc + length * direction,
            weight + length * weight_change,
            residual + length * residual_change,
        )

    carry = start, inertia @ start, rows.jacobian @ start - rows.target
    qacc, _, residual = jax.lax.fori_loop(0, iterations, step, carry)
    return qacc, -_row_forces(rows, residual)


def _row_forces(rows: Rows, residual: Float[Array, "*at row"]) -> Float[Array, "*at row"]:
    return jnp.clip(rows.stiffness * residual, rows.low, rows.high)


def exact_step(
    ends: Float[Array, "2 row"],
    excess: Float[Array, " row"],
    stiffness: Float[Array, " row"],
    residual_change: Float[Array, " row"],
    slope: Float[Array, ""],
    curvature: Float[Array, ""],
) -> Float[Array, ""]:
    """Return the step along a line that minimizes the function; 0 if no step decreases it.

    Args:
        ends: least and greatest change of each row's force.
        excess: unclipped minus clipped force of each row at the start of the line.
        stiffness: D of each row.
        residual_change: change of each row's residual along the line.
        slope: slope of the function at the start.
        curvature: curvature of the function without constraints.
    """
    change = stiffness * residual_change
    knots = (ends - excess) / jnp.where(jnp.abs(change) > 1e-20, change, jnp.inf)
    knots = jnp.where((knots > 0) & (knots < LONGEST_STEP), knots, 0.0).reshape(-1)
    # Beyond the last breakpoint the slope is linear, so two points define it.
    last = jnp.max(knots)
    knots = jnp.append(knots, last + 1.0)
    forces = jnp.clip(knots[:, None] * change + excess, ends[0], ends[1])
    slopes = slope + knots * curvature + jnp.sum(forces * residual_change, axis=1)
    descends = slopes < 0
    after = jnp.min(jnp.where(descends, jnp.inf, knots))
    inside = jnp.isfinite(after)
    before = jnp.where(inside, jnp.max(jnp.where(descends, knots, 0.0)), last)
    after = jnp.where(inside, after, last + 1.0)
    left = jnp.max(jnp.where(knots == before, slopes, -jnp.inf))
    right = jnp.max(jnp.where(knots == after, slopes, -jnp.inf))
    length = before - left * (after - before) / jnp.maximum(right - left, 1e-30)
    return jnp.where(slope < 0, length, 0.0)


# MJX prints a message if the optional warp is missing.
with contextlib.redirect_stdout(io.StringIO()):
    from mujoco import mjx
    from mujoco.mjx._src import constraint, math

NEWTON_ITERATIONS = 5
"""Number of Newton iterations per step, which start from the accelerations of the last step. If
started from zero at deep penetration, 8 iterations reach the minimum up to rounding. In rollouts, 5
iterations gave the same verdicts as 8."""
NEAR_GAP_M = 0.002
"""Largest gap between two geoms that count as near in the composed scene [m]."""
LOOKUP_STEPS = 5
"""Number of steps between two searches for near geoms."""
SPARE_PAIRS = 8
"""A step processes this number of pairs of geoms in addition to 1.5 times the number of pairs that
are near in the composed scene."""
CONTACTS_PER_BODY, FEWEST_CONTACTS = 8, 32
"""Number of contacts kept per movable body, and least number in total. The deepest are kept."""

MODEL_FIELDS = (
    *("body_pos", "body_quat", "body_ipos", "body_mass", "body_inertia", "geom_pos", "geom_size"),
    *("geom_rbound", "geom_aabb", "jnt_pos", "jnt_range", "jnt_stiffness", "jnt_actfrcrange"),
    *("dof_armature", "dof_damping", "dof_frictionloss", "qpos0", "qpos_spring", "eq_data"),
    *("geom_friction", "body_invweight0", "dof_invweight0"),
)

MjxData = mjx.Data
"""State and contacts, of one candidate or with a leading axis of candidates."""
Fields = dict[str, Any]
"""Per-candidate values of fields of `mjx.Model`, with a leading axis [pop]."""


class MjxModel(eqx.Module):
    """A scene for `mjx_step`: MJX's model and the solids of its geoms."""

    mjx: mjx.Model
    """Fields may be batched. The scale of a geom is its `geom_rbound` divided by its `rbound`."""
    solids: Solids
    pairs: GeomPairs
    rbound: Float[Array, " geom"]
    """Bounding radii of the geoms at scale 1 [m]."""
    near: int = eqx.field(static=True)
    """Number of pairs of geoms that a step processes. The nearest pairs are processed."""
    contacts: int = eqx.field(static=True)
    """Number of contacts that a step keeps. The deepest contacts are kept."""
    ellipsoids: bool = eqx.field(static=True)
    """True if any geom is an ellipsoid."""


def put_model(mjm: mujoco.MjModel, start: Float[np.ndarray, " nq"]) -> MjxModel:
    """Put a compiled model on JAX's default device.

    Args:
        mjm: the model.
        start: initial qpos, which determines the number of near pairs.

    Raises:
        EngineError: MJX cannot simulate the model.
    """
    pairs, solids = geom_pairs(mjm), geom_solids(mjm)
    bare = copy.copy(mjm)
    # Without colliding geoms, MJX has no pairs to unroll.
    bare.geom_contype[:] = 0
    bare.geom_conaffinity[:] = 0
    bare.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    # `newton` needs pyramidal cones, with which stiffer friction would stiffen normal forces.
    bare.opt.cone, bare.opt.impratio = mujoco.mjtCone.mjCONE_PYRAMIDAL, 1.0
    if not np.any(mjm.dof_damping) and not mjm.nu:
        # The integrator then treats nothing implicitly, and does not factor a second matrix.
        off = mujoco.mjtDisableBit.mjDSBL_DAMPER | mujoco.mjtDisableBit.mjDSBL_ACTUATION
        bare.opt.disableflags |= int(off)
    try:
        model = mjx.put_model(bare, impl="jax")
    except NotImplementedError as error:
        raise EngineError(
            f"engine mjx cannot simulate this scene: {error}; use --engine native"
        ) from None
    near = 3 * _near_at_start(mjm, start, pairs) // 2 + SPARE_PAIRS
    near = near if near < 3 * len(pairs.first) // 4 else len(pairs.first)
    movable = int(np.sum(mjm.body_weldid[1:] == np.arange(1, mjm.nbody)))
    return MjxModel(
        mjx=model,
        solids=jax.tree.map(jnp.asarray, solids),
        pairs=jax.tree.map(jnp.asarray, pairs),
        rbound=jnp.asarray(mjm.geom_rbound, jnp.float32),
        near=near,
        contacts=min(PAIR_CONTACTS * near, max(CONTACTS_PER_BODY * movable, FEWEST_CONTACTS)),
        ellipsoids=bool(np.any(np.ptp(solids.radii, axis=1) > 0)),
    )


def _near_at_start(mjm: mujoco.MjModel, start: np.ndarray, pairs: GeomPairs) -> int:
    if not len(pairs.first):
        return 0
    data = mujoco.MjData(mjm)
    data.qpos[:] = start
    mujoco.mj_kinematics(mjm, data)
    gap = box_gaps(
        data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3), mjm.geom_aabb.reshape(-1, 6), pairs
    )
    return int(np.sum(np.asarray(gap) < NEAR_GAP_M))


def candidate_fields(scene: CompiledScene, poses: Poses) -> tuple[Fields, Float[Array, "pop nq"]]:
    """Return the fields of `mjx.Model` in which candidates differ, and their initial states."""
    fields = model_fields(scene, poses) | invweights(scene, poses)
    return {name: fields[name] for name in MODEL_FIELDS if name in fields}, fields["qpos"]


def with_fields(model: MjxModel, fields: Fields) -> MjxModel:
    """Return the model with fields of `mjx.Model` replaced."""
    return eqx.tree_at(lambda m: m.mjx, model, model.mjx.replace(**fields))


def mjx_batch(scene: SceneModel, layouts: Layout) -> tuple[MjxModel, MjxModel, mjx.Data]:
    """Prepare candidates for `jax.vmap(mjx_step, in_axes=(axes, 0))`.

    Returns:
        The model, in which fields that depend on the layout have a leading axis [pop]; `axes`, the
        axes of the model for `vmap`; and the candidates' data, at rest in their placed poses.

    Raises:
        EngineError: MJX cannot simulate the scene.
    """
    model = put_model(scene.static.mjm, scene.static.start)
    fields, qpos = _candidates(scene, layouts)
    axes = with_fields(jax.tree.map(lambda _: None, model), dict.fromkeys(fields, 0))
    broadcast = lambda x: np.broadcast_to(np.asarray(x), (len(qpos), *np.shape(x)))
    data = jax.tree.map(broadcast, make_data(model)).replace(qpos=qpos)
    # MJX commits its model to a device. The first step would commit the data as well, so the second
    # step would be compiled again.
    device = model.mjx.qpos0.device
    put = lambda tree: jax.tree.map(lambda x: jax.device_put(x, device), tree)
    return put(with_fields(model, fields)), axes, put(data)


@eqx.filter_jit
def _candidates(scene: SceneModel, layouts: Layout) -> tuple[Fields, Float[Array, "pop nq"]]:
    return candidate_fields(scene, scene.place(layouts))


def make_data(model: MjxModel) -> mjx.Data:
    """Return the data of one candidate, at the model's qpos0, with memory for its contacts."""
    m = model.mjx
    data = mjx.make_data(m)
    dim = np.full(model.contacts, 3)
    kinds = constraint.make_efc_type(m, dim)
    ne, nf, nl, nc = (int(n) for n in constraint.counts(kinds))
    rows = ne + nf + nl + nc
    # On the host, where a new shape needs no compilation.
    zero = lambda *shape: np.zeros(shape, np.float32)
    n = model.contacts
    contact = cast(Any, data)._impl.contact.replace(
        **{"dist": zero(n), "pos": zero(n, 3), "frame": zero(n, 3, 3), "includemargin": zero(n)},
        **{"friction": zero(n, 5), "solref": zero(n, 2), "solreffriction": zero(n, 2)},
        **{"solimp": zero(n, 5), "geom": np.zeros((n, 2), np.int32), "dim": dim},
        **{"geom1": np.zeros(n, np.int32), "geom2": np.zeros(n, np.int32)},
        efc_address=constraint.make_efc_address(m, dim, kinds),
    )
    efc = {
        f"efc_{name}": zero(rows)
        for name in ("pos", "margin", "frictionloss", "D", "aref", "force")
    }
    impl = cast(Any, data)._impl.replace(
        ne=ne,
        nf=nf,
        nl=nl,
        nefc=rows,
        ncon=n,
        contact=contact,
        efc_type=kinds,
        efc_J=zero(rows, m.nv),
        **efc,
    )
    return data.replace(_impl=impl)


def mjx_step(
    model: MjxModel,
    data: mjx.Data,
    nstep: int = 1,
    push: Callable[[mjx.Data], mjx.Data] | None = None,
) -> mjx.Data:
    """Advance one candidate's simulation, as `mjx.step` does. Traceable; for `jax.vmap`.

    Args:
        model: the candidate's model.
        data: the candidate's state.
        nstep: number of time steps. Near geoms are searched in the first step and in every
            `LOOKUP_STEPS`-th step after it.
        push: function of the data that sets the applied forces before each step.
    """

    def advance(k: Any, carry: tuple[mjx.Data, Array]) -> tuple[mjx.Data, Array]:
        d, nearest = carry
        d = mjx.kinematics(model.mjx, d if push is None else push(d))
        # The condition is the same for all candidates, so vmap keeps it a scalar.
        search_pairs = lambda: nearest_pairs(model, d)
        nearest = (
            jax.lax.cond(k % LOOKUP_STEPS == 0, search_pairs, lambda: nearest)
            if nstep > 1
            else search_pairs()
        )
        return _dynamics(model, d, nearest), nearest

    # Ampere and later GPUs multiply single-precision matrices in TF32 by default.
    with jax.default_matmul_precision("highest"):
        start = data, jnp.arange(model.near, dtype=jnp.int32)
        return (advance(0, start) if nstep == 1 else jax.lax.fori_loop(0, nstep, advance, start))[0]


def _dynamics(model: MjxModel, d: mjx.Data, nearest: Int[Array, " near"]) -> mjx.Data:
    """Complete a step after its kinematics."""
    m = model.mjx
    for stage in (mjx.com_pos, mjx.crb, mjx.factor_m):
        d = stage(m, d)
    if model.contacts:
        d = collide(model, d, nearest)
    if m.nu:
        d = mjx.transmission(m, d)
    for stage in (mjx.make_constraint, mjx.fwd_velocity, mjx.fwd_actuation, mjx.fwd_acceleration):
        d = stage(m, d)
    constrained = bool(cast(Any, d)._impl.efc_J.size)
    d = solve(d, NEWTON_ITERATIONS) if constrained else d.replace(qacc=d.qacc_smooth)
    return mjx.implicit(m, _after_solver(d))


def _after_solver(d: mjx.Data) -> mjx.Data:
    """Add a dependency on the solver's result to the integrator's mass matrix.

    On CPUs JAX factors a batch of matrices on its thread pool and waits for other threads of that
    pool. Two concurrent factorizations deadlock on a pool of two threads (jaxlib 0.10 to 0.11). The
    dependency makes the integrator's factorization wait until that of `factor_m` has finished.
    """
    zero = jnp.minimum(jnp.abs(jnp.sum(d.qacc)), 0.0)
    impl = cast(Any, d)._impl
    return d.replace(_impl=impl.replace(M=impl.M + zero))


def nearest_pairs(model: MjxModel, d: mjx.Data) -> Int[Array, " near"]:
    """Return the indices of the pairs of geoms whose bounding boxes are nearest."""
    if model.near == len(model.pairs.first):
        return jnp.arange(model.near, dtype=jnp.int32)
    return jax.lax.top_k(-_gaps(model, d), model.near)[1]


def pairs_dropped(model: MjxModel, d: mjx.Data) -> Bool[Array, ""]:
    """Return whether more pairs of bounding boxes overlap than a step processes."""
    if model.near == len(model.pairs.first):
        return jnp.array(False)
    return jnp.sum(_gaps(model, d) < 0) > model.near


def _gaps(model: MjxModel, d: mjx.Data) -> Float[Array, " pair"]:
    return box_gaps(d.geom_xpos, d.geom_xmat, model.mjx.geom_aabb.reshape(-1, 6), model.pairs)


def box_gaps(xpos: Any, xmat: Any, aabb: Any, pairs: GeomPairs) -> Float[Array, " pair"]:
    """Return lower bounds of the gaps between geoms [m], from the faces of their bounding boxes.

    Args:
        xpos: [geom, 3] positions in the world.
        xmat: [geom, 3, 3] rotations.
        aabb: [geom, 6] centers and half edges of the boxes in the geoms' frames.
        pairs: pairs of geoms.
    """
    half = jnp.asarray(aabb[:, 3:])
    centre = xpos + jnp.sum(xmat * jnp.asarray(aabb[:, None, :3]), axis=-1)
    a, b = pairs.first, pairs.second
    offset = centre[b] - centre[a]
    one, two = jnp.asarray(xmat)[a], jnp.asarray(xmat)[b]
    turn = jnp.abs(jnp.sum(one[:, :, :, None] * two[:, :, None, :], axis=1))
    along = lambda rot: jnp.abs(jnp.sum(rot * offset[:, :, None], axis=1))
    gap = along(one) - half[a] - jnp.sum(turn * half[b][:, None, :], axis=2)
    other = along(two) - half[b] - jnp.sum(turn * half[a][:, :, None], axis=1)
    return jnp.maximum(jnp.max(gap, axis=1), jnp.max(other, axis=1))


def collide(model: MjxModel, d: mjx.Data, nearest: Int[Array, " near"]) -> mjx.Data:
    """Fill MJX's contacts with the deepest contacts of the nearest pairs of geoms."""
    pairs = jax.tree.map(lambda leaf: leaf[nearest], model.pairs)
    scale = model.mjx.geom_rbound / jnp.maximum(model.rbound, 1e-12)
    a, b = pairs.first, pairs.second
    centre = d.geom_xpos[a]

    def posed_solid(g: Int[Array, " pair"]) -> PosedSolid:
        solid = jax.tree.map(lambda leaf: leaf[g], model.solids)
        return PosedSolid(solid, d.geom_xpos[g] - centre, d.geom_xmat[g], scale[g])

    contacts = manifolds(posed_solid(a), posed_solid(b), model.ellipsoids)
    sliding, spinning, rolling = jnp.moveaxis(
        jnp.maximum(model.mjx.geom_friction[a], model.mjx.geom_friction[b]), -1, 0
    )
    friction = jnp.stack([sliding, sliding, spinning, rolling, rolling], axis=-1)
    dist, deepest = jax.lax.top_k(-contacts.dist.reshape(-1), model.contacts)
    pair = deepest // PAIR_CONTACTS
    geom = jnp.stack([a[pair], b[pair]], axis=1)
    contact = cast(Any, d)._impl.contact.replace(
        dist=-dist,
        pos=contacts.pos.reshape(-1, 3)[deepest] + centre[pair],
        frame=jax.vmap(math.make_frame)(contacts.normal[pair]),
        includemargin=jnp.zeros(model.contacts),
        friction=friction[pair],
        solref=pairs.solref[pair],
        solreffriction=jnp.zeros((model.contacts, 2)),
        solimp=pairs.solimp[pair],
        geom=geom,
        geom1=geom[:, 0],
        geom2=geom[:, 1],
    )
    return d.tree_replace({"_impl.contact": contact})

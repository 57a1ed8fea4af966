"""Newton's method for MuJoCo's constraints, with an exact line search.

The accelerations minimize a convex function that is quadratic between breakpoints, at which
constraints activate or deactivate (MuJoCo's documentation, Computation, "Primal problem"). Along a
line, the slope of this function is piecewise linear. MJX brackets the zero of the slope in some 64
passes over the constraint rows, which takes a third of a step's time on a GPU. This module
evaluates the slope at all breakpoints at once. The zero between two breakpoints is then exact.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

MjxState = Any
"""An `mjx.Data` of MJX's JAX implementation. Only `mjx_model` imports MJX, which prints."""
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

"""Feasibility of the objects in the initial layout, and the choice of the objects to move.

An object is feasible if, in the initial layout, it penetrates nothing deeper than the bound, is
stable in a rollout, and its box agrees with the photograph's within the noise. The search first
moves only objects that penetrate others or are unstable. If no candidate is valid, it also moves
their contact components, and then all objects. Objects that only disagree with the photograph
move after a valid candidate is found.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from ..config import CEMOptions, RefineOptions
from ..measure import SceneMeasure
from ..physics.array_types import AnyArray
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays, on_device
from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import from_yaw, rotate
from .algorithm import SearchState
from .cem import CEMState
from .credit import contact_components
from .objective import Placement, Scores

AGREES = 3.0
"""Largest error of a box side, in units of the noise, at which an object agrees with the photo."""
BORDERLINE = 2.0
"""Largest error, in the same units, at which the heading and size of a faulty object are not in
question."""
ITERATIONS_UNSETTLED = 1
"""Number of iterations without a valid candidate after which candidates are settled."""
SETTLE_BATCH = 64
"""Number of candidates settled at once, in decreasing order of their bounds; in an iteration with a
valid candidate, no further batch is settled. On photographs most elites are in the first batch."""
ITERATIONS_PER_STAGE = 2
"""Number of iterations without a valid candidate after which more objects may move."""
MIN_ROLLED_OUT = 64
"""Smallest number of candidates for `always_falling`."""
FARTHER_FACTOR = 4.0
"""Factor of the initial deviation of x and y, for objects that fell in every candidate."""
FALL_DRIFT = 2.0
"""Drift, in units of the stability bounds, beyond which an object is unsupported."""


class InitialFeasibility(NamedTuple):
    """Feasibility of each object in the initial layout."""

    feasible: Bool[np.ndarray, " object"]
    """True for objects that are not faulty and agree with the photograph."""
    faulty: Bool[np.ndarray, " object"]
    """True for objects that penetrate others or are unstable."""
    box_error: Float[np.ndarray, " object"]
    """Error of each object's box in units of the noise; see `semantic.box_error`."""


def assess_initial(
    placement: Placement,
    scores: Scores,
    failed: Bool[np.ndarray, " object"],
    o: RefineOptions,
) -> InitialFeasibility:
    """Return the feasibility of each object in the first candidate.

    Args:
        placement: the candidates.
        scores: their scores.
        failed: objects that fail the final check, which lasts longer than a rollout.
        o: options, for the bounds.
    """
    stable = np.asarray(scores.drift[0]) < 1.0
    apart = np.asarray(scores.depth[0]) < o.max_depth_m
    box_error = np.asarray(placement.box_error[0])
    agrees = box_error <= AGREES
    faulty = ~(stable & apart & np.isfinite(scores.absolute[0]))
    faulty |= np.pad(failed, (0, len(faulty) - len(failed)))
    return InitialFeasibility(agrees & ~faulty, faulty, box_error)


def failing(
    names: Sequence[str], measure: SceneMeasure, o: RefineOptions
) -> Bool[np.ndarray, " object"]:
    """Return a mask of the objects that penetrate others or are unstable in a final check."""
    deep = {n for p, d in measure.depths_m.items() if d > o.max_depth_m for n in p.split("|")}
    unstable = {
        name
        for name, drift in measure.drift_m.items()
        if not (drift < o.max_drift_m and measure.tilt_deg[name] < o.max_tilt_deg)
    }
    return np.array([name in deep | unstable for name in names])


def stages(
    scene: SceneArrays, initial: InitialFeasibility, options: CEMOptions
) -> list[Bool[np.ndarray, " object"]]:
    """Return the masks of movable objects, one per stage of ITERATIONS_PER_STAGE iterations."""
    movable = np.asarray(scene.optimised)
    first = movable & initial.faulty
    if not first.any():
        first = movable & ~initial.feasible
    components = contact_components(scene, options.model_copy(update={"credit": "island"})) > 0
    wider = movable & (components[:, first].any(axis=1) | first)
    masks: list[Bool[np.ndarray, " object"]] = []
    for mask in (first, wider, movable):
        if not masks or (mask != masks[-1]).any():
            masks.append(mask)
    return masks


def photo_mismatches(
    scene: SceneArrays, initial: InitialFeasibility, first: Bool[np.ndarray, " object"]
) -> Bool[np.ndarray, " object"] | None:
    """Return the objects that only disagree with the photo; None if all of them move first."""
    later = np.asarray(scene.optimised) & ~initial.feasible & ~first
    return later if later.any() else None


def deviation_share(
    initial: InitialFeasibility, options: CEMOptions
) -> Float[np.ndarray, " object"]:
    """Return the factor of the initial deviations of yaw and scale for each object.

    The parse estimates headings and sizes well, so only faulty objects whose boxes disagree with
    the photograph get the full deviation. A stable object that disagrees is displaced rather than
    rotated.
    """
    uncertain = initial.faulty & (initial.box_error > BORDERLINE)
    return np.where(uncertain, 1.0, options.sigma_agreeing).astype(np.float32)


def initial_summary(
    names: Sequence[str], initial: InitialFeasibility, optimised: Bool[np.ndarray, " object"]
) -> str:
    """Return a progress line that lists the objects that move."""
    count = int(optimised.sum())

    def listed(mask: Bool[np.ndarray, " object"]) -> str:
        return ", ".join(names[k] for k in np.flatnonzero(optimised & mask).tolist())

    faulty, mismatched = listed(initial.faulty), listed(~initial.feasible & ~initial.faulty)
    if not (faulty or mismatched):
        return f"all {count} objects are valid in the initial layout"
    fixed_count = int((optimised & initial.feasible).sum())
    moving = ", then to match the photograph ".join(text for text in (faulty, mismatched) if text)
    return f"{fixed_count} of {count} objects are valid and stay fixed; moving {moving}"


def widen_deviations(state: SearchState, sigma: Layout) -> SearchState:
    """Set zero deviations of objects that may move to their initial values.

    Args:
        state: state of a search; returned unchanged unless the optimizer is CEM.
        sigma: initial deviations of the movable objects, pop axis of length 1.
    """
    if not isinstance(state.optimizer, CEMState):
        return state

    def keep(old: AnyArray, new: AnyArray) -> np.ndarray:
        return np.where(np.asarray(old) > 0, old, new)

    std = on_device(jax.tree.map(keep, state.optimizer.std, sigma))
    return eqx.tree_at(lambda s: s.optimizer.std, state, std)


def search_farther(
    state: SearchState, sigma: Layout, falling: Bool[np.ndarray, " object"], spec: SceneSpec
) -> SearchState:
    """Move the search distribution of falling objects over their supports, and widen it.

    The mean moves by `offset_from_support`; the deviation is FARTHER_FACTOR times the initial one.

    Args:
        state: state of a search; returned unchanged unless the optimizer is CEM.
        sigma: initial deviations, pop axis of length 1.
        falling: mask of the objects that fell in every candidate.
        spec: the composed scene.
    """
    if not isinstance(state.optimizer, CEMState):
        return state
    mean, std = state.optimizer.mean, state.optimizer.std
    padded = np.pad(falling, (0, sigma.yaw.shape[1] - len(falling)))
    deviation = np.where(
        padded[None, :, None], FARTHER_FACTOR * np.asarray(sigma.xy), np.asarray(std.xy)
    )
    center = np.array(mean.xy, np.float32)
    for k in np.flatnonzero(falling):
        center[0, k] -= offset_from_support(spec, spec.objects[k], center[0, k])
    arrays = on_device((center, deviation.astype(np.float32)))
    return eqx.tree_at(lambda s: (s.optimizer.mean.xy, s.optimizer.std.xy), state, arrays)


def offset_from_support(
    spec: SceneSpec, item: SceneObject, xy: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, " 2"]:
    """Return the offset of an object's center from the area of its support's box [m].

    The area is the box inset by half the object's size, but at most by a quarter of the box's.

    Args:
        spec: the composed scene.
        item: the object.
        xy: position in a layout, as in `Layout.xy`.
    """
    if item.parent is None or item.parent_link is not None:
        return np.zeros(2)
    parent = spec.object(item.parent)
    low, high = (side[:2] for side in bounds(parent.spec, parent.joint_state, parent.base_tilt))
    object_low, object_high = bounds(item.spec, item.joint_state, item.base_tilt)
    margin = np.minimum((object_high - object_low)[:2] / 2, (high - low) / 4)
    center = rotate(from_yaw(item.yaw), (object_low + object_high) / 2)[:2] + np.array(item.xy) + xy
    return center - np.clip(center, low + margin, high - margin)


def should_settle(o: RefineOptions, iterations: int, scorer: object) -> bool:
    """Return whether candidates are settled from this iteration on, if none was valid so far.

    Always False without simulation, or if a model scores rendered images of layouts.
    """
    if o.settle == "never" or scorer is not None or not o.rollout.duration_s:
        return False
    return o.settle == "always" or iterations >= ITERATIONS_UNSETTLED


def always_falling(
    drifts: Sequence[Float[np.ndarray, "pop object"]],
) -> Bool[np.ndarray, " object"] | None:
    """Return the objects that fell in every candidate so far; None if too few were rolled out.

    Args:
        drifts: drifts of each iteration's candidates, over the stability bounds; NaN if pruned.
    """
    rolled = np.concatenate(drifts)
    rolled = rolled[np.isfinite(rolled).all(axis=1)]
    return np.all(rolled > FALL_DRIFT, axis=0) if len(rolled) >= MIN_ROLLED_OUT else None

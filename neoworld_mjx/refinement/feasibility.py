"""What the search leaves alone: objects that are sound where they stand.

An object is sound if, in the layout that the search starts at, it penetrates nothing deeper than
the bound, holds still in a rollout, and its box agrees with the photograph's within the noise. The
search moves first what penetrates or does not hold still. Where that finds nothing valid, what they
may come to touch makes room, and then everything may move. What merely disagrees with the
photograph moves once the others are valid, so that a valid scene is known by then.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from ..config import CEMOptions, RefineOptions
from ..measure import SceneMeasure
from ..physics.layout import Layout
from ..physics.scene_arrays import SceneArrays, on_device
from ..spec import SceneObject, SceneSpec, bounds
from ..spec.pose import from_yaw, rotate
from .algorithm import SearchState
from .cem import CEMState
from .credit import contact_components
from .objective import Placement, Scores

AGREES = 3.0
"""Error of a box side, in units of the noise, up to which an object agrees with the photograph."""
BORDERLINE = 2.0
"""The same up to which it gives no reason to doubt the heading and size of an object, not even of a
faulty one."""
ITERATIONS_UNSETTLED = 1
"""Iterations without a valid candidate after which candidates come to rest."""
SETTLE_BATCH = 64
"""Candidates that come to rest at once, those first that agree best with the photograph; no more do
so in an iteration once one is valid. Most elites were among them on photographs."""
ITERATIONS_PER_STAGE = 2
"""Iterations without a valid candidate after which more objects may move."""
MIN_ROLLED_OUT = 64
"""Candidates in all of which an object must fall for the search to be without hope."""
FARTHER_FACTOR = 4.0
"""Of the initial deviation of x and y, for objects that fell in every candidate."""
FALL_DRIFT = 2.0
"""Drift, in units of the stability bounds, of an object that nothing holds."""


class InitialFeasibility(NamedTuple):
    """Which objects are sound where they stand, and which are not for reasons of physics."""

    sound: Bool[np.ndarray, " object"]
    faulty: Bool[np.ndarray, " object"]
    """Objects that penetrate others or do not hold still."""
    box_error: Float[np.ndarray, " object"]
    """How far each object's box is off the photograph's, in units of the noise."""


def assess_initial(
    placement: Placement,
    scores: Scores,
    failed: Bool[np.ndarray, " object"],
    o: RefineOptions,
) -> InitialFeasibility:
    """Tell which objects are sound in the first candidate.

    Args:
        placement: the candidates.
        scores: theirs.
        failed: objects that fail the final check as the first candidate leaves them; it goes on
            for longer than a rollout.
        o: options, for the bounds.
    """
    still = np.asarray(scores.drift[0]) < 1.0
    apart = np.asarray(scores.depth[0]) < o.max_depth_m
    box_error = np.asarray(placement.box_error[0])
    agrees = box_error <= AGREES
    faulty = ~(still & apart & np.isfinite(scores.absolute[0]))
    faulty |= np.pad(failed, (0, len(faulty) - len(failed)))
    return InitialFeasibility(agrees & ~faulty, faulty, box_error)


def failing(
    names: Sequence[str], measure: SceneMeasure, o: RefineOptions
) -> Bool[np.ndarray, " object"]:
    """Return which objects overlap others or do not hold still in a final check."""
    deep = {n for p, d in measure.depths_m.items() if d > o.max_depth_m for n in p.split("|")}
    restless = {
        name
        for name, drift in measure.drift_m.items()
        if not (drift < o.max_drift_m and measure.tilt_deg[name] < o.max_tilt_deg)
    }
    return np.array([name in deep | restless for name in names])


def stages(
    scene: SceneArrays, start: InitialFeasibility, options: CEMOptions
) -> list[Bool[np.ndarray, " object"]]:
    """Return the objects that may move at first, after ITERATIONS_PER_STAGE iterations, and so on."""
    every = np.asarray(scene.optimised)
    first = every & start.faulty
    if not first.any():
        first = every & ~start.sound
    islands = contact_components(scene, options.model_copy(update={"credit": "island"})) > 0
    wider = every & (islands[:, first].any(axis=1) | first)
    steps: list[Bool[np.ndarray, " object"]] = []
    for mask in (first, wider, every):
        if not steps or (mask != steps[-1]).any():
            steps.append(mask)
    return steps


def photo_mismatches(
    scene: SceneArrays, start: InitialFeasibility, first: Bool[np.ndarray, " object"]
) -> Bool[np.ndarray, " object"] | None:
    """Return the objects that only the photograph asks to move, unless they move from the first."""
    later = np.asarray(scene.optimised) & ~start.sound & ~first
    return later if later.any() else None


def deviation_share(start: InitialFeasibility, options: CEMOptions) -> Float[np.ndarray, " object"]:
    """Return which share of the initial deviations of yaw and scale each object has.

    Answers judge headings and sizes well: where a box agrees with the photograph's, nothing asks
    for others, and what rests soundly beside its box is elsewhere rather than turned.
    """
    doubted = start.faulty & (start.box_error > BORDERLINE)
    return np.where(doubted, 1.0, options.sigma_agreeing).astype(np.float32)


def initial_line(
    names: Sequence[str], start: InitialFeasibility, optimised: Bool[np.ndarray, " object"]
) -> str:
    """Say which objects stay and which move."""
    count = int(optimised.sum())
    listed = lambda mask: ", ".join(names[k] for k in np.flatnonzero(optimised & mask).tolist())
    faulty, off = listed(start.faulty), listed(~start.sound & ~start.faulty)
    if not (faulty or off):
        return f"all {count} objects are sound where they stand"
    stay = int((optimised & start.sound).sum())
    moving = ", then by the photograph ".join(text for text in (faulty, off) if text)
    return f"{stay} of {count} objects are sound and stay; moving {moving}"


def widen_deviations(state: SearchState, sigma: Layout) -> SearchState:
    """Give objects that may move from now on their initial deviation.

    Args:
        state: of a search by CEM, or one whose optimizer has no deviations of its own.
        sigma: initial deviations of all that may move, pop axis of length 1.
    """
    if not isinstance(state.optimizer, CEMState):
        return state
    keep = lambda old, new: np.where(np.asarray(old) > 0, old, new)
    std = on_device(jax.tree.map(keep, state.optimizer.std, sigma))
    return eqx.tree_at(lambda s: s.optimizer.std, state, std)


def search_farther(
    state: SearchState, sigma: Layout, falling: Bool[np.ndarray, " object"], spec: SceneSpec
) -> SearchState:
    """Look for objects that fell in every candidate over what carries them, and farther around.

    Their mean moves by `offset_from_support`, their deviation is FARTHER_FACTOR times that of the start.

    Args:
        state: of a search by CEM, or one whose optimizer has no deviations of its own.
        sigma: initial deviations, pop axis of length 1.
        falling: which they are.
        spec: the composed scene.
    """
    if not isinstance(state.optimizer, CEMState):
        return state
    mean, std = state.optimizer.mean, state.optimizer.std
    padded = np.pad(falling, (0, sigma.yaw.shape[1] - len(falling)))
    far = np.where(padded[None, :, None], FARTHER_FACTOR * np.asarray(sigma.xy), np.asarray(std.xy))
    centre = np.array(mean.xy, np.float32)
    for k in np.flatnonzero(falling):
        centre[0, k] -= offset_from_support(spec, spec.objects[k], centre[0, k])
    arrays = on_device((centre, far.astype(np.float32)))
    return eqx.tree_at(lambda s: (s.optimizer.mean.xy, s.optimizer.std.xy), state, arrays)


def offset_from_support(
    spec: SceneSpec, item: SceneObject, xy: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, " 2"]:
    """Return how far an object's middle is beside where its carrier's box can hold it [m].

    That is half the object's size within the box, but at most a quarter of the box's.

    Args:
        spec: the composed scene.
        item: the object.
        xy: where a layout puts it, as in `Layout.xy`.
    """
    if item.parent is None or item.parent_link is not None:
        return np.zeros(2)
    parent = spec.object(item.parent)
    low, high = (side[:2] for side in bounds(parent.spec, parent.joint_state, parent.base_tilt))
    own_low, own_high = bounds(item.spec, item.joint_state, item.base_tilt)
    margin = np.minimum((own_high - own_low)[:2] / 2, (high - low) / 4)
    middle = rotate(from_yaw(item.yaw), (own_low + own_high) / 2)[:2] + np.array(item.xy) + xy
    return middle - np.clip(middle, low + margin, high - margin)


def should_settle(o: RefineOptions, iterations: int, scorer: object) -> bool:
    """Tell whether candidates come to rest from now on, as nothing was valid so far.

    Not where there is no simulation, nor where a model scores pictures of layouts.
    """
    if o.settle == "never" or scorer is not None or not o.rollout.duration_s:
        return False
    return o.settle == "always" or iterations >= ITERATIONS_UNSETTLED


def always_falling(
    drifts: Sequence[Float[np.ndarray, "pop object"]],
) -> Bool[np.ndarray, " object"] | None:
    """Tell which objects fell in every candidate so far; None while too few were rolled out.

    Args:
        drifts: of each iteration's candidates, in units of the stability bounds; NaN where pruned.
    """
    rolled = np.concatenate(drifts)
    rolled = rolled[np.isfinite(rolled).all(axis=1)]
    return np.all(rolled > FALL_DRIFT, axis=0) if len(rolled) >= MIN_ROLLED_OUT else None

"""Revert moves of the search that proved unnecessary.

A search moves many objects at once, and within the noise of the photograph many positions are
equally good. A move is reverted if the scene still passes the final check and the visible boxes
agree with the photograph's as well as before, within the noise. Objects are reverted in groups,
which are halved on failure; a single object that cannot be fully reverted is reverted by half.
Headings and sizes are also reverted separately, since resolving an overlap seldom needs a rotation
or a change of size. The parse estimates them well and boxes constrain them weakly, so they are
reverted unless the loss of likelihood by the boxes exceeds the gain by the parse.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool

from ..config import RefineOptions
from ..measure import SceneMeasure, measured, passes, seen_box_iou
from ..physics.array_types import AnyArray
from ..physics.exact import snap_exactly
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.placed import CPU_CHUNK, at_rest_in_chunks, placed_in_chunks
from ..physics.scene_arrays import SceneArrays, pad_objects, pad_scene
from ..physics.settling import at_rest
from ..physics.visibility import Visible
from ..spec import SceneSpec
from .choosing import Chosen, choose, moved_away, world_pose
from .feasibility import failing
from .objective import Objective, has_builtin_terms_only
from .rounds import Round
from .semantic import reprojection_residual

STILL_M, STILL = 1e-5, 1e-5
"""Largest changes of position [m], and of yaw [rad] or log scale, of an unmoved object."""
WHOLE = ("xy", "yaw", "log_scale")
"""All parts of an object's layout."""
HEADING, SIZE = ("yaw",), ("log_scale",)
"""Parts that are also reverted separately."""
SHARES = {WHOLE: (1.0, 0.5), HEADING: (1.0, 0.5, 0.25), SIZE: (1.0,)}
"""Fractions of a move that are reverted, tried in order for a single object."""
RETURN_PHASES = ((True, 1.0), (False, 1.0), (True, 0.5))
"""Phases in which a reverted layout settles; see `at_rest`."""
NOISE = 0.03
"""Loss of an object's visible-box IoU within the noise of a parsed box."""
PARSE_SIGMA = {"yaw": np.radians(3.0), "log_scale": 0.03}
"""Standard deviations of parsed headings [rad] and log scales; see `_log_likelihood_gain`."""
STUDENT_DOF = 3.0
"""Degrees of freedom of their Student's t-distribution."""


class PhotoAgreement(NamedTuple):
    """Agreement of a layout with the photograph."""

    ious: dict[str, float]
    """IoU of each object's visible box with the photograph's."""
    residual: float
    """Result of `reprojection_residual`: half the squared box errors in units of their noise."""


class Winner(NamedTuple):
    """Winner of a search, with its exact check."""

    chosen: Chosen
    layout: Layout
    """Pop axis of length 1; the initial layout, if the rollout of every candidate failed."""
    before: SceneMeasure
    """Final check of the initial layout."""


def choose_and_revert(
    model: SceneModel,
    rounds: list[Round],
    o: RefineOptions,
    objective: Objective,
    start: Layout | None = None,
    checked: SceneMeasure | None = None,
) -> Winner:
    """Choose the winner of a search, and revert its unnecessary moves.

    Nothing is reverted if the reward has user-defined terms or scores by a model.

    Args:
        model: the compiled scene.
        rounds: all iterations.
        o: options of the check.
        objective: objective of the search.
        start: initial layout, pop axis of length 1; None is the composed scene.
        checked: final check of the initial layout; computed if None.
    """
    origin = Layout.zero(1, len(model.names)) if start is None else start
    exact = snap_exactly(model.apply(origin, 0))
    before = measured(exact, o) if checked is None else checked
    chosen = choose(model, rounds, o, start, (exact, before))
    t, k = chosen.index
    layout = rounds[t].layouts[k : k + 1] if t >= 0 else origin
    rests = t >= 0 and bool(rounds[t].rests[k])
    if o.semantic.scorer != "geometric" or not has_builtin_terms_only(objective):
        return Winner(chosen, layout, before)
    return Winner(*revert_moves(model, chosen, layout, origin, before, o, rests=rests), before)


def revert_moves(
    model: SceneModel,
    chosen: Chosen,
    layout: Layout,
    start: Layout,
    before: SceneMeasure,
    o: RefineOptions,
    *,
    rests: bool = False,
) -> tuple[Chosen, Layout]:
    """Revert moves of a winner that passes the final check toward the initial layout.

    Args:
        model: the compiled scene.
        chosen: the winner.
        layout: layout of the winner, pop axis of length 1.
        start: the initial layout, pop axis of length 1.
        before: final check of `start`, which determines the objects that had to move.
        o: options; `returns` limits the number of checks.
        rests: True if the winner was settled; reverted layouts are then settled too.

    Returns:
        The winner with its final check, and its layout; the arguments if nothing is reverted.
    """
    moved = _moved_mask(layout, start) & np.asarray(model.optimised)
    if not (chosen.passed and o.returns and moved.any()):
        return chosen, layout
    faulty = failing(model.names, before, o)
    groups = [(moved & ~faulty, WHOLE), (moved, HEADING), (moved & faulty, WHOLE), (moved, SIZE)]
    padded = pad_scene(model)
    initial_agreement, placed_agreement = _placed_agreement(model, padded, [start, layout])
    settled_agreement = (
        _settled_agreement(model, padded, layout, chosen.scene) if rests else placed_agreement
    )
    steps, checks_left = [(chosen, layout)], o.returns
    evaluated: dict[_Attempt, tuple[Layout, PhotoAgreement]] = {}
    while groups and checks_left:
        group, parts = groups.pop(0)
        group = group & _moved_mask(layout, start, parts)
        for key in _attempts(group, parts)[:checks_left]:
            checks_left -= 1
            if key not in evaluated:
                # Likely next attempts are evaluated together: a few cost as much as one.
                keys = _upcoming_attempts([(group, parts), *groups], layout, start)
                new_layouts = [_blended(layout, start, *t.values()) for t in keys]
                new_agreements = _placed_agreement(model, padded, new_layouts)
                evaluated = dict(
                    zip(keys, zip(new_layouts, new_agreements, strict=True), strict=True)
                )
            nearer, agreement = evaluated[key]
            likelihood_gain = (
                -np.inf if parts == WHOLE else _log_likelihood_gain(layout, nearer, start, group)
            )
            accepted_placed = _accepted(
                agreement, placed_agreement, initial_agreement, likelihood_gain
            )
            passing = None if accepted_placed is None else _checked_scene(model, nearer, o, rests)
            if accepted_placed is None or passing is None:
                continue
            accepted = accepted_placed
            if rests:
                accepted = _accepted(
                    _settled_agreement(model, padded, nearer, passing[0]),
                    settled_agreement,
                    initial_agreement,
                    likelihood_gain,
                )
            if accepted is not None:
                layout, placed_agreement, settled_agreement = nearer, accepted_placed, accepted
                steps.append((replace(chosen, scene=passing[0], measure=passing[1]), layout))
                evaluated.clear()
                break
        else:
            if group.sum() > 1:
                halves = [(half, parts) for half in _halves(group)]
                # Headings first: checks are limited, and boxes constrain headings least.
                groups = halves + groups if parts == HEADING else groups + halves
    for best, layout in steps[:0:-1]:
        measure = measured(best.scene, o)
        if passes(measure, o):
            return replace(best, measure=measure), layout
    return steps[0]


def _accepted(
    new: PhotoAgreement, reference: PhotoAgreement, initial: PhotoAgreement, likelihood_gain: float
) -> PhotoAgreement | None:
    """Return the agreement that later attempts must maintain; None if the attempt is rejected.

    Args:
        new: agreement after the attempt.
        reference: agreement to maintain.
        initial: agreement of the initial layout.
        likelihood_gain: log-likelihood gain of headings and sizes, which may offset a loss by the
            boxes; -inf if only the boxes decide.
    """
    if all(new.ious[name] >= iou - NOISE for name, iou in reference.ious.items()):
        # The best IoU so far stays the reference, so that losses do not accumulate.
        return new._replace(ious={n: max(iou, reference.ious[n]) for n, iou in new.ious.items()})
    floor = {name: min(iou, initial.ious[name]) for name, iou in reference.ious.items()}
    agrees = all(new.ious[name] >= iou - NOISE for name, iou in floor.items())
    return new if agrees and new.residual - reference.residual <= likelihood_gain else None


def _checked_scene(
    model: SceneModel, layout: Layout, o: RefineOptions, rests: bool
) -> tuple[SceneSpec, SceneMeasure] | None:
    """Return a layout's scene and check if it passes with resting objects asleep, else None."""
    placed = model.apply(layout, 0)
    scene = at_rest(placed, RETURN_PHASES, sleeps=True) if rests else snap_exactly(placed)
    measure = measured(scene, o, sleeps=True)
    if not passes(measure, o):
        return None
    if rests and moved_away(model, placed, scene, np.asarray(layout.log_scale)[0]):
        return None
    return scene, measure


def _log_likelihood_gain(
    layout: Layout, nearer: Layout, start: Layout, group: Bool[np.ndarray, " object"]
) -> float:
    """Return the gain of log-likelihood of headings and sizes from moving to `nearer`."""

    def negative_log_likelihood(candidate: Layout) -> float:
        total = 0.0
        for part, deviation in PARSE_SIGMA.items():
            values, initial = (np.asarray(getattr(z, part))[0, group] for z in (candidate, start))
            total += float(np.sum(np.log1p(((values - initial) / deviation) ** 2 / STUDENT_DOF)))
        return (STUDENT_DOF + 1) / 2 * total

    return negative_log_likelihood(layout) - negative_log_likelihood(nearer)


def _placed_agreement(
    model: SceneModel, padded: SceneArrays, layouts: list[Layout]
) -> list[PhotoAgreement]:
    """Return the agreement of placed layouts with the photograph."""
    if model.spec.camera is None:
        return [PhotoAgreement({}, 0.0)] * len(layouts)
    stacked = jax.tree.map(lambda *x: np.concatenate([np.asarray(a) for a in x]), *layouts)
    visible = placed_in_chunks(padded, pad_objects(stacked, padded.count)).visible
    return [_agreement(model, padded, visible, k) for k in range(len(layouts))]


def _settled_agreement(
    model: SceneModel, padded: SceneArrays, layout: Layout, rest: SceneSpec
) -> PhotoAgreement:
    """Return the agreement of a settled layout with the photograph."""
    if model.spec.camera is None:
        return PhotoAgreement({}, 0.0)
    end = world_pose(rest, np.exp(np.asarray(layout.log_scale)[:, : len(model.names)]))
    end = jax.tree.map(np.float32, pad_objects(end, padded.count))
    return _agreement(model, padded, at_rest_in_chunks(padded, end, end).visible, 0)


def _agreement(model: SceneModel, padded: SceneArrays, visible: Visible, k: int) -> PhotoAgreement:
    """Return the agreement of a candidate's visible regions with the photograph."""
    candidate = jax.tree.map(lambda x: np.asarray(x)[k : k + 1], visible)
    residual = float(reprojection_residual(padded, candidate.outlines, np)[0])
    return PhotoAgreement(seen_box_iou(model.spec, padded, candidate), residual)


class _Attempt(NamedTuple):
    """Reversion of parts of a group's layout by a fraction."""

    group: tuple[bool, ...]
    share: float
    parts: tuple[str, ...]

    def values(self) -> tuple[Bool[np.ndarray, " object"], float, tuple[str, ...]]:
        return np.array(self.group), self.share, self.parts


def _upcoming_attempts(
    groups: Sequence[tuple[Bool[np.ndarray, " object"], tuple[str, ...]]],
    layout: Layout,
    start: Layout,
) -> list[_Attempt]:
    """Return the next attempts, including those with halves of groups; at most CPU_CHUNK."""
    queue, tries = list(groups), dict[_Attempt, None]()
    while queue and len(tries) < CPU_CHUNK:
        mask, parts = queue.pop(0)
        group = mask & _moved_mask(layout, start, parts)
        tries |= dict.fromkeys(_attempts(group, parts))
        if group.sum() > 1:
            queue += [(half, parts) for half in _halves(group)]
    return list(tries)[:CPU_CHUNK]


def _attempts(group: Bool[np.ndarray, " object"], parts: tuple[str, ...]) -> list[_Attempt]:
    """Return the attempts for a group, in order; the first accepted one ends the list."""
    shares = SHARES[parts] if group.sum() == 1 else (1.0,)
    return (
        [_Attempt(tuple(group.tolist()), share, parts) for share in shares] if group.any() else []
    )


def _moved_mask(
    layout: Layout, start: Layout, parts: tuple[str, ...] = WHOLE
) -> Bool[np.ndarray, " object"]:
    """Return a mask of the objects that differ from the initial layout in some parts."""
    difference = jax.tree.map(
        lambda a, b: np.abs(np.asarray(a)[0] - np.asarray(b)[0]), layout, start
    )
    moved = {
        "xy": difference.xy.max(axis=-1) > STILL_M,
        "yaw": difference.yaw > STILL,
        "log_scale": difference.log_scale > STILL,
    }
    return np.any([moved[part] for part in parts], axis=0)


def _blended(
    layout: Layout,
    start: Layout,
    group: Bool[np.ndarray, " object"],
    share: float,
    parts: tuple[str, ...],
) -> Layout:
    """Interpolate parts of a group's layout toward the initial layout."""

    def mix(a: AnyArray, b: AnyArray) -> np.ndarray:
        a, b = np.asarray(a), np.asarray(b)
        mask = group.reshape(1, -1, *[1] * (a.ndim - 2))
        return np.where(mask, (1 - share) * a + share * b, a).astype(a.dtype)

    mixed = {part: mix(getattr(layout, part), getattr(start, part)) for part in parts}
    return replace(layout, **mixed)


def _halves(group: Bool[np.ndarray, " object"]) -> list[Bool[np.ndarray, " object"]]:
    members = np.flatnonzero(group)
    halves = []
    for part in np.array_split(members, 2):
        half = np.zeros(len(group), bool)
        half[part] = True
        halves.append(half)
    return halves

"""Return objects that the search moved without need to where they were composed.

A search moves everything at once, and within the noise of the photograph one place is as good as
another. So whatever may go back does: the scene must still pass the final check, and no visible box
may agree less with the photograph's than within its noise. Objects are returned in groups, halved
where that fails; one that cannot go back alone goes half the way. Headings and sizes are also
returned by themselves: what had to make room seldom had to turn or shrink for it. Answers judge
them well, and boxes show them badly, so they go back unless that is less likely by the boxes than
it is likelier by the answer.
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
from .semantic import boxes_off

STILL_M, STILL = 1e-5, 1e-5
"""Changes of place [m], and of yaw [rad] or log scale, up to which an object has not moved."""
WHOLE = ("xy", "yaw", "log_scale")
"""All that a layout says of an object."""
HEADING, SIZE = ("yaw",), ("log_scale",)
"""Parts of it that are also returned by themselves."""
SHARES = {WHOLE: (1.0, 0.5), HEADING: (1.0, 0.5, 0.25), SIZE: (1.0,)}
"""Shares of the way back that are tried with an object alone."""
RETURN_PHASES = ((True, 1.0), (False, 1.0), (True, 0.5))
"""How a returned layout comes to rest; see `at_rest`."""
NOISE = 0.03
"""Loss of an object's visible-box IoU that the noise of a parsed box explains."""
JUDGED = {"yaw": np.radians(3.0), "log_scale": 0.03}
"""Standard deviations of the headings [rad] and log scales of answers; see `_log_likelihood_gain`."""
OUTLYING = 3.0
"""Degrees of freedom of their distribution, Student's: few are much further off."""


class PhotoAgreement(NamedTuple):
    """What the photograph says of a layout."""

    ious: dict[str, float]
    """Of each object's visible box with the photograph's."""
    off: float
    """Of `boxes_off`: half the squared errors of all boxes in units of their noise."""


class Winner(NamedTuple):
    """The outcome of a search, checked exactly."""

    chosen: Chosen
    layout: Layout
    """Pop axis of length 1; where the search started, if every candidate failed in physics."""
    before: SceneMeasure
    """Final check of where the search started."""


def choose_and_revert(
    model: SceneModel,
    rounds: list[Round],
    o: RefineOptions,
    objective: Objective,
    start: Layout | None = None,
    checked: SceneMeasure | None = None,
) -> Winner:
    """Choose the winner of a search, and put back what it moved without need.

    Nothing is put back where a term of the user's own, or a model's scores, decided too.

    Args:
        model: the compiled scene.
        rounds: all iterations.
        o: options of the check.
        objective: of the search.
        start: layout at which the search started, pop axis of length 1; None is the composed scene.
        checked: final check of that, where it is known.
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
    """Return objects of a winner that passes the final check to the layout the search started at.

    Args:
        model: the compiled scene.
        chosen: the winner.
        layout: the winner's, pop axis of length 1.
        start: the layout to return to, pop axis of length 1.
        before: final check of `start`, which tells what had to move.
        o: options; `returns` bounds the checks.
        rests: whether the winner came to rest; then so does whatever is tried.

    Returns:
        The winner with its final check, and its layout; the given ones if nothing may return.
    """
    moved = _moved(layout, start) & np.asarray(model.optimised)
    if not (chosen.passed and o.returns and moved.any()):
        return chosen, layout
    faulty = failing(model.names, before, o)
    groups = [(moved & ~faulty, WHOLE), (moved, HEADING), (moved & faulty, WHOLE), (moved, SIZE)]
    padded = pad_scene(model)
    composed, as_placed = _placed_agreement(model, padded, [start, layout])
    seen = _settled_agreement(model, padded, layout, chosen.scene) if rests else as_placed
    steps, left = [(chosen, layout)], o.returns
    looks: dict[_Attempt, tuple[Layout, PhotoAgreement]] = {}
    while groups and left:
        group, parts = groups.pop(0)
        group = group & _moved(layout, start, parts)
        for key in _attempts(group, parts)[:left]:
            left -= 1
            if key not in looks:
                # What may be next is looked at beside it: a few cost as much as one.
                keys = _upcoming_attempts([(group, parts), *groups], layout, start)
                new = [_blended(layout, start, *t.values()) for t in keys]
                seen_new = _placed_agreement(model, padded, new)
                looks = dict(zip(keys, zip(new, seen_new, strict=True), strict=True))
            nearer, look = looks[key]
            likelier = (
                -np.inf if parts == WHOLE else _log_likelihood_gain(layout, nearer, start, group)
            )
            kept_placed = _accepted(look, as_placed, composed, likelier)
            found = None if kept_placed is None else _checked_scene(model, nearer, o, rests)
            if kept_placed is None or found is None:
                continue
            kept = kept_placed
            if rests:
                kept = _accepted(
                    _settled_agreement(model, padded, nearer, found[0]), seen, composed, likelier
                )
            if kept is not None:
                layout, as_placed, seen = nearer, kept_placed, kept
                steps.append((replace(chosen, scene=found[0], measure=found[1]), layout))
                looks.clear()
                break
        else:
            if group.sum() > 1:
                halves = [(half, parts) for half in _halves(group)]
                # Headings first: there are few checks, and boxes tell least about them.
                groups = halves + groups if parts == HEADING else groups + halves
    for best, layout in steps[:0:-1]:
        measure = measured(best.scene, o)
        if passes(measure, o):
            return replace(best, measure=measure), layout
    return steps[0]


def _accepted(
    new: PhotoAgreement, seen: PhotoAgreement, composed: PhotoAgreement, likelier: float
) -> PhotoAgreement | None:
    """Return what is to be kept of the photograph's agreement if a return may be made, else None.

    Args:
        new: what is seen after it.
        seen: what was to be kept before.
        composed: what is seen where the search started.
        likelier: by how much the return makes headings and sizes likelier, which boxes may be less
            likely for; -inf where boxes decide.
    """
    if all(new.ious[name] >= iou - NOISE for name, iou in seen.ious.items()):
        # What is lost in one step is not lost again in the next.
        return new._replace(ious={n: max(iou, seen.ious[n]) for n, iou in new.ious.items()})
    floor = {name: min(iou, composed.ious[name]) for name, iou in seen.ious.items()}
    agrees = all(new.ious[name] >= iou - NOISE for name, iou in floor.items())
    return new if agrees and new.off - seen.off <= likelier else None


def _checked_scene(
    model: SceneModel, layout: Layout, o: RefineOptions, rests: bool
) -> tuple[SceneSpec, SceneMeasure] | None:
    """Return a layout's scene and its check if it passes one in which what rests sleeps."""
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
    """Return how much likelier headings and sizes nearer to the start's are, as a logarithm."""

    def unlikely(of: Layout) -> float:
        total = 0.0
        for part, deviation in JUDGED.items():
            off = (np.asarray(getattr(of, part)) - np.asarray(getattr(start, part)))[0, group]
            total += float(np.sum(np.log1p((off / deviation) ** 2 / OUTLYING)))
        return (OUTLYING + 1) / 2 * total

    return unlikely(layout) - unlikely(nearer)


def _placed_agreement(
    model: SceneModel, padded: SceneArrays, layouts: list[Layout]
) -> list[PhotoAgreement]:
    """Look at layouts as they are placed."""
    if model.spec.camera is None:
        return [PhotoAgreement({}, 0.0)] * len(layouts)
    many = jax.tree.map(lambda *x: np.concatenate([np.asarray(a) for a in x]), *layouts)
    visible = placed_in_chunks(padded, pad_objects(many, padded.count)).visible
    return [_agreement(model, padded, visible, k) for k in range(len(layouts))]


def _settled_agreement(
    model: SceneModel, padded: SceneArrays, layout: Layout, rest: SceneSpec
) -> PhotoAgreement:
    """Look at where a layout came to rest."""
    if model.spec.camera is None:
        return PhotoAgreement({}, 0.0)
    end = world_pose(rest, np.exp(np.asarray(layout.log_scale)[:, : len(model.names)]))
    end = jax.tree.map(np.float32, pad_objects(end, padded.count))
    return _agreement(model, padded, at_rest_in_chunks(padded, end, end).visible, 0)


def _agreement(model: SceneModel, padded: SceneArrays, visible: Visible, k: int) -> PhotoAgreement:
    """Compare what the camera sees of a candidate with the photograph."""
    own = jax.tree.map(lambda x: np.asarray(x)[k : k + 1], visible)
    off = float(boxes_off(padded, own.outlines, np)[0])
    return PhotoAgreement(seen_box_iou(model.spec, padded, own), off)


class _Attempt(NamedTuple):
    """A share of the way back of parts of a group's layout."""

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
    """Return the next tries, those with halves of groups too; at most CPU_CHUNK."""
    queue, tries = list(groups), dict[_Attempt, None]()
    while queue and len(tries) < CPU_CHUNK:
        mask, parts = queue.pop(0)
        group = mask & _moved(layout, start, parts)
        tries |= dict.fromkeys(_attempts(group, parts))
        if group.sum() > 1:
            queue += [(half, parts) for half in _halves(group)]
    return list(tries)[:CPU_CHUNK]


def _attempts(group: Bool[np.ndarray, " object"], parts: tuple[str, ...]) -> list[_Attempt]:
    """Return what is tried with a group, one after the other until one may stay."""
    shares = SHARES[parts] if group.sum() == 1 else (1.0,)
    return (
        [_Attempt(tuple(group.tolist()), share, parts) for share in shares] if group.any() else []
    )


def _moved(
    layout: Layout, start: Layout, parts: tuple[str, ...] = WHOLE
) -> Bool[np.ndarray, " object"]:
    """Tell which objects are elsewhere than at the start, by some parts of the layout."""
    off = jax.tree.map(lambda a, b: np.abs(np.asarray(a)[0] - np.asarray(b)[0]), layout, start)
    moved = {
        "xy": off.xy.max(axis=-1) > STILL_M,
        "yaw": off.yaw > STILL,
        "log_scale": off.log_scale > STILL,
    }
    return np.any([moved[part] for part in parts], axis=0)


def _blended(
    layout: Layout,
    start: Layout,
    group: Bool[np.ndarray, " object"],
    share: float,
    parts: tuple[str, ...],
) -> Layout:
    """Move parts of a group's layout by a share of the way back to the start."""

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

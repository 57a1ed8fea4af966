"""Return objects that the search moved without need to where they were composed.

A search moves everything at once, and within the noise of the photograph one place is as good as
another. So whatever may go back does: the scene must still pass the final check, and no visible box
may agree less with the photograph's than within its noise. Objects are returned in groups, halved
where that fails; one that cannot go back alone goes half the way. Headings and sizes are also
returned by themselves: what had to make room seldom had to turn or shrink for it. Answers judge
them well, and boxes show them badly, so they go back unless that is less likely by the boxes than
it is likelier by the answer.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool

from ..config import RefineOptions
from ..measure import SceneMeasure, measured, passes, seen_box_iou
from ..physics.exact import snap_exactly
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..physics.placed import at_rest_in_chunks, placed_in_chunks
from ..physics.scene_arrays import SceneArrays, pad_objects, pad_scene
from ..physics.settling import at_rest
from ..physics.support import Either
from ..spec import SceneSpec
from .objective import Objective, photograph_decides
from .outcome import Chosen, Round, choose, moved_away, world_pose
from .semantic import boxes_off
from .soundness import failing

STILL_M, STILL = 1e-5, 1e-5
"""Changes of place [m], and of yaw [rad] or log scale, up to which an object has not moved."""
WHOLE = ("xy", "yaw", "log_scale")
"""All that a layout says of an object."""
HEADING, SIZE = ("yaw",), ("log_scale",)
"""Parts of it that are also returned by themselves."""
SHARES = {WHOLE: (1.0, 0.5), HEADING: (1.0, 0.5, 0.25), SIZE: (1.0,)}
"""Shares of the way back that are tried with an object alone."""
SINKING = ((True, 1.0), (False, 1.0), (True, 0.5))
"""How a returned layout comes to rest; see `at_rest`."""
NOISE = 0.03
"""Loss of an object's visible-box IoU that the noise of a parsed box explains."""
JUDGED = {"yaw": np.radians(3.0), "log_scale": 0.03}
"""Standard deviations of the headings [rad] and log scales of answers; see `_likelier`."""
OUTLYING = 3.0
"""Degrees of freedom of their distribution, Student's: few are much further off."""


class Seen(NamedTuple):
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


def choose_and_return(
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
    if o.semantic.scorer != "geometric" or not photograph_decides(objective):
        return Winner(chosen, layout, before)
    return Winner(*return_moved(model, chosen, layout, origin, before, o, rests=rests), before)


def return_moved(
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
    best, composed = chosen, _seen(model, padded, start, None)
    seen, left = _seen(model, padded, layout, chosen.scene if rests else None), o.returns
    while groups and left:
        group, parts = groups.pop(0)
        group = group & _moved(layout, start, parts)
        shares = SHARES[parts] if group.sum() == 1 else (1.0,)
        for share in shares[:left] if group.any() else ():
            left -= 1
            nearer = _mixed(layout, start, group, share, parts)
            found = _checked(model, nearer, o, rests)
            if found is None:
                continue
            new = _seen(model, padded, nearer, found[0] if rests else None)
            likelier = -np.inf if parts == WHOLE else _likelier(layout, nearer, start, group)
            kept = _kept(new, seen, composed, likelier)
            if kept is not None:
                layout, seen = nearer, kept
                best = replace(best, scene=found[0], measure=found[1])
                break
        else:
            if group.sum() > 1:
                halves = [(half, parts) for half in _halves(group)]
                # Headings first: there are few checks, and boxes tell least about them.
                groups = halves + groups if parts == HEADING else groups + halves
    return best, layout


def _kept(new: Seen, seen: Seen, composed: Seen, likelier: float) -> Seen | None:
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


def _checked(
    model: SceneModel, layout: Layout, o: RefineOptions, rests: bool
) -> tuple[SceneSpec, SceneMeasure] | None:
    """Return a layout's scene and its final check if it passes."""
    placed = model.apply(layout, 0)
    scene: SceneSpec = at_rest(placed, SINKING) if rests else snap_exactly(placed)
    measure = measured(scene, o)
    if not passes(measure, o):
        return None
    if rests and moved_away(model, placed, scene, np.asarray(layout.log_scale)[0]):
        return None
    return scene, measure


def _likelier(
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


def _seen(model: SceneModel, padded: SceneArrays, layout: Layout, rest: SceneSpec | None) -> Seen:
    """Look at a layout, or at where it came to rest."""
    if model.spec.camera is None:
        return Seen({}, 0.0)
    layout = pad_objects(layout, padded.count)
    if rest is None:
        visible = placed_in_chunks(padded, layout).visible
    else:
        end = world_pose(rest, np.exp(np.asarray(layout.log_scale)[:, : len(model.names)]))
        end = jax.tree.map(np.float32, pad_objects(end, padded.count))
        visible = at_rest_in_chunks(padded, end, end).visible
    off = float(boxes_off(padded, visible.outlines, np)[0])
    return Seen(seen_box_iou(model.spec, padded, visible), off)


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


def _mixed(
    layout: Layout,
    start: Layout,
    group: Bool[np.ndarray, " object"],
    share: float,
    parts: tuple[str, ...],
) -> Layout:
    """Move parts of a group's layout by a share of the way back to the start."""

    def mix(a: Either, b: Either) -> np.ndarray:
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

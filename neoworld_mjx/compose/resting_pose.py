"""Resting poses on level ground: the tilt nearest to a parsed one at which an object is stable.

A parsed tilt is a round figure: a mushroom tipped by 90 degrees would float at its stem, as its cap
is thicker. The search does not move tilts, so the parsed tilt is followed downhill until the centre
of mass is at a local minimum of height.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from ..spec import ObjectSpec, Quat, SceneTree, TreeNode, inertial, link_poses, pieces
from ..spec.convex import Piece
from ..spec.pose import IDENTITY, conjugate, from_axis_angle, quat_mul, rotate

MAX_TILT_RAD = np.radians(30.0)
"""Beyond this the object is held by something else, or its parsed tilt is wrong."""
LEVEL_M = 1e-7
"""Height by which tilting lowers what is unstable, at least; a ball's middle stays level."""
_FIRST_STEP_RAD, _LAST_STEP_RAD = np.radians(4.0), np.radians(0.01)


def resting_tilt(spec: ObjectSpec, state: dict[str, float], tilt: Quat) -> Quat | None:
    """Return the tilt nearest to a given one at which an object rests on level ground.

    Args:
        spec: the object.
        state: how its joints stand.
        tilt: parsed rotation before yaw.

    Returns:
        The tilt, or None if no rest is within 30 degrees.
    """
    lowest = _lowest_points(spec, state)
    parsed = rotate(conjugate(np.array(tilt)), np.array([0.0, 0.0, -1.0]))
    down, step = parsed, _FIRST_STEP_RAD
    low = float((lowest(down) @ down).max())
    known = np.vstack([lowest(direction) for direction in (down, *_beside(down, step))])
    while step > _LAST_STEP_RAD:
        direction, predicted = _lowered(known, down, step)
        points = lowest(direction)
        known = np.vstack([known, points])
        height = float((points @ direction).max())
        if low - height > max(0.5 * (low - predicted), 1e-9):
            down, low = direction, height
        else:
            step *= 0.85  # The points found there are known now.
        if down @ parsed < np.cos(MAX_TILT_RAD):
            return None
    return _turned(tilt, down, parsed)


def stands(spec: ObjectSpec, state: dict[str, float]) -> bool:
    """Tell whether tilting an upright object lifts its centre of mass, so that it stays upright.

    What fails this may stand all the same, on a foot narrower than the tilt: see `resting_tilt`.
    """
    lowest, down = _lowest_points(spec, state), np.array([0.0, 0.0, -1.0])
    least = float((lowest(down) @ down).max()) - LEVEL_M
    sides = _beside(down, _FIRST_STEP_RAD)
    sides += [(a + b) / np.linalg.norm(a + b) for a in sides[:2] for b in sides[2:]]
    return all(float((lowest(side) @ side).max()) >= least for side in sides)


def _lowest_points(spec: ObjectSpec, state: dict[str, float]) -> Callable[[NDArray], NDArray]:
    """Return a function of a unit vector down: each piece's furthest point that way, from the
    centre of mass [n, 3] m.
    """
    moved = link_poses(spec, state)
    placed = [
        (piece, moved[part.name].then(at)) for part in spec.parts for _, piece, at in pieces(part)
    ]
    bodies = [(inertial(spec, part), moved[part.name]) for part in spec.parts]
    masses = [own.mass for own, _ in bodies]
    centre = np.average([at.apply(own.pos) for own, at in bodies], axis=0, weights=masses)

    def lowest(down: NDArray) -> NDArray:
        return (
            np.array([at.apply(_furthest(s, rotate(conjugate(at.quat), down))) for s, at in placed])
            - centre
        )

    return lowest


def on_level(node: TreeNode, tree: SceneTree) -> bool:
    """Tell whether an object is on an environment support made from its box: on level ground."""
    carried = node.parent is not None and tree.node(node.parent).slab
    return carried and node.relation == "on"


def pose_without_scene(node: TreeNode, spec: ObjectSpec, *, level: bool) -> tuple[Quat, bool]:
    """Return the tilt at which to verify an object by itself on level ground.

    A lying object is verified in its resting pose. One that its scene holds, as it leans, hangs, or
    is tilted in or on something that is not level, would by itself only fall.

    Args:
        node: the object, as parsed.
        spec: the object.
        level: whether it is on level ground in its scene.

    Returns:
        Its tilt, and whether its scene holds it.
    """
    tilt = node.base_tilt
    if node.environment or node.fastened or node.relation in ("leaning", "attached"):
        return tilt, True
    if np.allclose(tilt, IDENTITY):
        return tilt, False
    rest = resting_tilt(spec, {}, tilt)
    return (tilt, not level) if rest is None else (rest, False)


def _beside(down: NDArray, step: float) -> list[NDArray]:
    """Return unit vectors to four sides of one."""
    across = np.linalg.svd(down[None])[2][1:]
    return [(down + side) / np.hypot(1.0, step) for side in step * np.vstack([across, -across])]


def _lowered(points: NDArray, down: NDArray, step: float) -> tuple[NDArray, float]:
    """Minimise the extent of points [n, 3] along a direction within a step of `down`.

    The extent is a maximum of linear functions, whose valleys have creases; a linear program
    follows them.

    Returns:
        The unit vector, and the extent along it [m].
    """
    across = np.linalg.svd(down[None])[2][1:]
    solution = linprog(
        [0.0, 0.0, 1.0],
        A_ub=np.column_stack([points @ across.T, -np.ones(len(points))]),
        b_ub=-points @ down,
        bounds=[(-step, step), (-step, step), (None, None)],
    )
    direction = down + solution.x[:2] @ across
    direction /= np.linalg.norm(direction)
    return direction, float((points @ direction).max())


def _furthest(piece: Piece, d: NDArray) -> NDArray:
    """Return the point of a piece that is furthest along a unit vector, in the piece's frame."""
    s = np.array(piece.size)
    if piece.kind == "mesh":
        vertices = np.array(piece.vertices)
        return vertices[np.argmax(vertices @ d)]
    if piece.kind == "box":
        return np.where(d >= 0, s, -s)
    if piece.kind == "sphere":
        return d * s[0]
    if piece.kind == "ellipsoid":
        return s * s * d / np.linalg.norm(s * d)
    end = np.array([0.0, 0.0, s[1] if d[2] >= 0 else -s[1]])
    if piece.kind == "capsule":
        return end + d * s[0]
    return end + np.array([d[0], d[1], 0.0]) * (s[0] / max(float(np.hypot(d[0], d[1])), 1e-12))


def _turned(tilt: Quat, normal: NDArray, down: NDArray) -> Quat:
    """Add to a tilt the smallest rotation that takes `normal` to where `down` was."""
    axis = np.cross(normal, down)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return tilt
    turn = from_axis_angle(axis / sine, float(np.arctan2(sine, normal @ down)))
    quat = quat_mul(np.array(tilt), turn)
    return tuple((quat / np.linalg.norm(quat)).tolist())

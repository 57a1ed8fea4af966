"""Things that lie: the parsed tilt is in round figures, the thing rests at its own.

A mushroom tipped by 90 degrees floats at its stem, as its cap is thicker. The search moves four numbers,
tilt not among them, so it would have to prop such a thing up with others. Here it is let down, from how
it was seen, until its centre of mass is as low as it gets: that is where it rests.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from ..spec import ObjectSpec, Quat, SceneTree, TreeNode, inertial, link_poses, pieces
from ..spec.convex import Piece
from ..spec.pose import IDENTITY, conjugate, from_axis_angle, quat_mul, rotate

MOST_RAD = np.radians(30.0)
"""Beyond this the thing is held by something else, or was seen wrongly."""
_FIRST_RAD, _LAST_RAD = np.radians(4.0), np.radians(0.01)


def resting_tilt(spec: ObjectSpec, state: dict[str, float], tilt: Quat) -> Quat | None:
    """Return the tilt nearest to a given one at which an object rests on level ground.

    Args:
        spec: the object.
        state: how its joints stand.
        tilt: rotation before yaw, as it was seen.

    Returns:
        The tilt, or None if no rest is within 30 degrees.
    """
    moved = link_poses(spec, state)
    solids = [
        (piece, moved[part.name].then(at)) for part in spec.parts for _, piece, at in pieces(part)
    ]
    bodies = [(inertial(spec, part), moved[part.name]) for part in spec.parts]
    masses = [own.mass for own, _ in bodies]
    centre = np.average([at.apply(own.pos) for own, at in bodies], axis=0, weights=masses)

    def lowest(down: NDArray) -> NDArray:
        """Return each piece's furthest point that way, from the centre of mass [n, 3] m."""
        return (
            np.array([at.apply(_furthest(s, rotate(conjugate(at.quat), down))) for s, at in solids])
            - centre
        )

    seen = rotate(conjugate(np.array(tilt)), np.array([0.0, 0.0, -1.0]))
    down, step = seen, _FIRST_RAD
    low = float((lowest(down) @ down).max())
    known = np.vstack([lowest(way) for way in (down, *_beside(down, step))])
    while step > _LAST_RAD:
        way, hoped = _lowered(known, down, step)
        found = lowest(way)
        known = np.vstack([known, found])
        height = float((found @ way).max())
        if low - height > max(0.5 * (low - hoped), 1e-9):
            down, low = way, height
        else:
            step *= 0.85  # What was found there is known now.
        if down @ seen < np.cos(MOST_RAD):
            return None
    return _turned(tilt, down, seen)


def on_level(node: TreeNode, tree: SceneTree) -> bool:
    """Tell whether a thing lies on level ground, rather than in something, on a dish or on a slope."""
    carried = node.parent is not None and tree.node(node.parent).environment
    return carried and node.relation == "on"


def alone(node: TreeNode, spec: ObjectSpec, *, level: bool) -> tuple[Quat, bool]:
    """Return how an object stands when it is tried by itself on level ground, without its scene.

    What lies is tried on the side that it will lie on. What is held by its scene, as it leans, hangs, or
    is tilted in or on something that is not level, would by itself only fall.

    Args:
        node: the object, as parsed.
        spec: the object.
        level: whether it lies on level ground in its scene.

    Returns:
        Its tilt, and whether it is held.
    """
    seen = node.base_tilt
    if node.environment or node.fixed_base or node.relation in ("leaning", "attached"):
        return seen, True
    if np.allclose(seen, IDENTITY):
        return seen, False
    rest = resting_tilt(spec, {}, seen)
    return (seen, not level) if rest is None else (rest, False)


def _beside(down: NDArray, step: float) -> list[NDArray]:
    """Return unit vectors to four sides of one."""
    across = np.linalg.svd(down[None])[2][1:]
    return [(down + side) / np.hypot(1.0, step) for side in step * np.vstack([across, -across])]


def _lowered(points: NDArray, down: NDArray, step: float) -> tuple[NDArray, float]:
    """Return the unit vector within a step of `down` along which no point [n, 3] is far, and how far.

    Seen from a direction the furthest of some points is a maximum of linear functions, whose valleys
    have creases; a linear program walks along them.
    """
    across = np.linalg.svd(down[None])[2][1:]
    found = linprog(
        [0.0, 0.0, 1.0],
        A_ub=np.column_stack([points @ across.T, -np.ones(len(points))]),
        b_ub=-points @ down,
        bounds=[(-step, step), (-step, step), (None, None)],
    )
    way = down + found.x[:2] @ across
    way /= np.linalg.norm(way)
    return way, float((points @ way).max())


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

"""Support polygon of an object at rest: its width, and the margin of the center of mass."""

import itertools

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from shapely import MultiPoint, Point

from ..physics.mjcf import START, body_name
from ..spec import bounds, link_poses, pieces
from ..spec.convex import Piece, box_around
from ..spec.pose import matrix, pose
from .simulation import Simulation


def support_polygon(simulation: Simulation, slack: float = 0.0) -> tuple[float, float]:
    """Return the width and the margin of an object's support polygon on a level floor.

    The support polygon is the convex hull of the contacts with the floor.

    Args:
        simulation: the object.
        slack: height above the object's lowest point up to which a piece counts as touching the
            floor [m]. Values below 1 mm count as 1 mm.

    Returns:
        The smallest width of the polygon [m], and the distance of the center of mass from the
        border of the polygon [m], which is positive inside the polygon.
    """
    spec, tilt = simulation.spec, pose((0, 0, 0), simulation.tilt)
    links = link_poses(spec, {})
    posed_pieces = [
        (piece, tilt.then(links[p.name]).then(piece_pose))
        for p in spec.parts
        for _, piece, piece_pose in pieces(p)
    ]
    bottoms = [float(box_around(piece, piece_pose)[0][2]) for piece, piece_pose in posed_pieces]
    reach = min(bottoms) + max(0.001, 0.002 * float(simulation.size[2]), slack)
    points = np.vstack(
        [
            _contact_points(piece, piece_pose.pos, matrix(piece_pose.quat), reach)
            for (piece, piece_pose), bottom in zip(posed_pieces, bottoms, strict=True)
            if bottom <= reach
        ]
    )
    data, model = simulation.data, simulation.model
    mujoco.mj_resetDataKeyframe(model, data, model.key(START).id)
    data.qpos[:3], data.qpos[3:7] = 0.0, simulation.tilt
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    centre = data.subtree_com[simulation.root][:2]
    try:
        hull = ConvexHull(points)
    except QhullError:
        # The points lie on a line or coincide.
        return 0.0, -MultiPoint(points).convex_hull.distance(Point(centre))
    faces = hull.equations
    corners = points[hull.vertices]
    widths = np.ptp(corners @ faces[:, :2].T, axis=0)
    return float(widths.min()), float(-(faces[:, :2] @ centre + faces[:, 2]).max())


def _contact_points(piece: Piece, pos: NDArray, rotation: NDArray, reach: float) -> NDArray:
    """Return the horizontal positions of a piece's lowest points below a height.

    Args:
        piece: the convex piece.
        pos: position of the piece [m], shape [3].
        rotation: rotation matrix of the piece, shape [3, 3].
        reach: the height [m].

    Returns:
        Positions of corners, or of points where a round piece touches the floor [m], shape [n, 2].
    """
    s = np.array(piece.size)
    if piece.kind == "mesh":
        local = np.array(piece.vertices)
    elif piece.kind == "box":
        local = np.array(list(itertools.product((-1, 1), repeat=3))) * s
    else:
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ring = np.column_stack([np.cos(angle), np.sin(angle)])
        if piece.kind == "cylinder":
            local = np.vstack(
                [np.column_stack([ring * s[0], np.full(24, z)]) for z in (-s[1], s[1])]
            )
        else:
            # A sphere or an ellipsoid touches the floor at its lowest point, and a capsule at the
            # lowest points of its two ends.
            half = s[1] if piece.kind == "capsule" else 0.0
            ends = np.array([[0, 0, -half], [0, 0, half]])
            radius = s if piece.kind == "ellipsoid" else np.full(3, s[0])
            lowest = radius**2 * -rotation[2]
            lowest = lowest / np.sqrt(np.sum((rotation[2] * radius) ** 2))
            local = ends + lowest
    points = local @ rotation.T + pos
    return points[points[:, 2] <= reach + 1e-9][:, :2].reshape(-1, 2)


def on_wheels(simulation: Simulation) -> bool:
    """Return True if a part on a continuous joint touches the floor."""
    data, model = simulation.data, simulation.model
    data.qpos[:], data.qvel[:] = model.key_qpos[0], 0.0
    low, _ = bounds(simulation.spec, {}, tuple(simulation.tilt.tolist()))
    data.qpos[:7] = [0, 0, -low[2] - 1e-4, *simulation.tilt]
    mujoco.mj_forward(model, data)
    pairs = data.contact.geom[: data.ncon]
    touching_bodies = model.geom_bodyid[pairs[(pairs == simulation.floor).any(axis=1)]]
    return any(
        model.body(body_name(simulation.spec, joint.child)).id in touching_bodies
        for joint in simulation.spec.joints
        if joint.type == "continuous"
    )

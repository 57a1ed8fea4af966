"""Support polygon of a resting object: its width, and the margin of the centre of mass."""

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from ..physics.mjcf import START, body_name
from ..spec import bounds, link_poses, pieces
from ..spec.convex import Piece, box_around
from ..spec.pose import matrix, pose
from .simulation import Simulation


def support_polygon(simulation: Simulation, slack: float = 0.0) -> tuple[float, float]:
    """Measure the convex hull of an object's points of contact with a level floor.

    Args:
        simulation: the object.
        slack: height [m] above its lowest point up to which a piece counts as touching; a
            millimetre always does.

    Returns:
        The smallest width of the polygon [m], and the distance [m] of the centre of mass from its
        border, positive inside.
    """
    spec, tilt = simulation.spec, pose((0, 0, 0), simulation.tilt)
    links = link_poses(spec, simulation.state)
    placed = [
        (piece, tilt.then(links[p.name]).then(at)) for p in spec.parts for _, piece, at in pieces(p)
    ]
    bottoms = [float(box_around(piece, at)[0][2]) for piece, at in placed]
    reach = min(bottoms) + max(0.001, 0.002 * float(simulation.size[2]), slack)
    points = np.vstack(
        [
            _contact_points(piece, at.pos, matrix(at.quat), reach)
            for (piece, at), bottom in zip(placed, bottoms, strict=True)
            if bottom <= reach
        ]
    )
    data, model = simulation.data, simulation.model
    mujoco.mj_resetDataKeyframe(model, data, model.key(START).id)
    data.qpos[:3], data.qpos[3:7] = 0.0, simulation.tilt
    for joint, value in simulation.state.items():
        data.qpos[simulation.address(joint)[0]] = value
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    centre = data.subtree_com[simulation.root][:2]
    try:
        hull = ConvexHull(points)
    except QhullError:
        return 0.0, -_distance_to_segment(points, centre)
    faces = hull.equations
    corners = points[hull.vertices]
    spread = corners @ faces[:, :2].T
    return float(np.ptp(spread, axis=0).min()), float(-(faces[:, :2] @ centre + faces[:, 2]).max())


def _contact_points(piece: Piece, pos: NDArray, rotation: NDArray, reach: float) -> NDArray:
    """Return the horizontal positions [n, 2] m of a piece's corners below a height [m]."""
    s = np.array(piece.size)
    if piece.kind == "mesh":
        local = np.array(piece.vertices)
    elif piece.kind == "box":
        local = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * s
    else:
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        ring = np.column_stack([np.cos(angle), np.sin(angle)])
        if piece.kind == "cylinder":
            local = np.vstack(
                [np.column_stack([ring * s[0], np.full(24, z)]) for z in (-s[1], s[1])]
            )
        else:
            # A sphere or ellipsoid touches at its lowest point, a capsule at that of either end.
            half = s[1] if piece.kind == "capsule" else 0.0
            ends = np.array([[0, 0, -half], [0, 0, half]])
            radius = s if piece.kind == "ellipsoid" else np.full(3, s[0])
            down = radius**2 * -rotation[2]
            down = down / np.sqrt(np.sum((rotation[2] * radius) ** 2))
            local = ends + down
    points = local @ rotation.T + pos
    return points[points[:, 2] <= reach + 1e-9][:, :2].reshape(-1, 2)


def _distance_to_segment(points: NDArray, centre: NDArray) -> float:
    """Return the distance [m] of a point [2] from the segment that collinear points [n, 2] span."""
    ends = points[[int(np.argmin(points.sum(axis=1))), int(np.argmax(points.sum(axis=1)))]]
    far = points[int(np.argmax(np.linalg.norm(points - ends[0], axis=1)))]
    direction = far - ends[0]
    share = np.clip(
        (centre - ends[0]) @ direction / max(float(direction @ direction), 1e-12), 0.0, 1.0
    )
    return float(np.linalg.norm(centre - ends[0] - share * direction))


def on_wheels(simulation: Simulation) -> bool:
    """Return True if a part on a continuous joint touches the floor."""
    data, model = simulation.data, simulation.model
    data.qpos[:], data.qvel[:] = model.key_qpos[0], 0.0
    low, _ = bounds(simulation.spec, simulation.state, tuple(simulation.tilt.tolist()))
    data.qpos[:7] = [0, 0, -low[2] - 1e-4, *simulation.tilt]
    mujoco.mj_forward(model, data)
    wheels = {
        model.body(body_name(simulation.spec, j.child)).id
        for j in simulation.spec.joints
        if j.type == "continuous"
    }
    touching = {
        int(model.geom_bodyid[g])
        for pair in data.contact.geom[: data.ncon]
        for g in pair
        if simulation.floor in pair and g != simulation.floor
    }
    return bool(touching & wheels)

"""Exact distances between the parts of an object in any joint state.

MuJoCo's contact list omits pairs of parent and child, but `mj_geomDistance` measures every pair.
The model has no dynamics: every convex piece is a geom of the world body, and its pose is set from
the object's kinematics.
"""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.exact import geom_distance
from ..physics.mjcf import GEOM_TYPES
from ..spec import ObjectSpec, link_poses, pieces
from ..spec.pose import rotate


class OutOfTime(Exception):
    """Raised if measuring an object exceeds the limit on processor time."""


@dataclass(frozen=True)
class PieceDistance:
    """Indices of two convex pieces, and their signed distance [m], negative if they overlap."""

    first: int
    second: int
    distance: float


class Probe:
    """Convex pieces of an object, for measuring distances between them in a joint state.

    Args:
        spec: the object.
        seconds: processor time [s] of the current thread after which `OutOfTime` is raised.
    """

    def __init__(self, spec: ObjectSpec, seconds: float = float("inf")) -> None:
        self.spec = spec
        self._deadline = time.thread_time() + seconds
        self.names = [part.name for part in spec.parts]
        world = mujoco.MjSpec()
        owner: list[int] = []
        geom: list[int] = []
        order = [g.name for part in spec.parts for g in part.geoms]
        for index, part in enumerate(spec.parts):
            for collider, piece, pose in pieces(part):
                added = world.worldbody.add_geom(
                    type=GEOM_TYPES[piece.kind], size=piece.size, pos=pose.pos, quat=pose.quat
                )
                if piece.kind == "mesh":
                    added.meshname = f"m{len(owner)}"
                    mesh = world.add_mesh(name=added.meshname)
                    mesh.uservert = np.array(piece.vertices).ravel()
                    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
                owner.append(index)
                geom.append(order.index(collider.name))
            self.check_time()
        self._model = world.compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)
        self.owner, self.geom = np.array(owner), np.array(geom)
        self._first = np.searchsorted(self.owner, np.arange(len(spec.parts)))
        self.geom_names = order
        self._rest_pos = self._data.geom_xpos.copy()
        self._rest_mat = self._data.geom_xmat.reshape(-1, 3, 3).copy()
        self.low = self.high = np.zeros((len(owner), 3))
        self.place({})

    def check_time(self) -> None:
        """Raise `OutOfTime` if the limit on processor time is exceeded."""
        if time.thread_time() > self._deadline:
            raise OutOfTime

    def place(self, joint_state: Mapping[str, float]) -> None:
        """Set the poses of all pieces from joint positions [rad or m]; missing joints are at 0."""
        self.check_time()
        poses = link_poses(self.spec, dict(joint_state))
        quats = np.array([poses[name].quat for name in self.names])
        rotations = rotate(quats[:, None], np.eye(3)).swapaxes(1, 2)[self.owner]
        offsets = np.array([poses[name].pos for name in self.names])[self.owner]
        xpos = np.einsum("gij,gj->gi", rotations, self._rest_pos) + offsets
        xmat = rotations @ self._rest_mat
        self._data.geom_xpos[:] = xpos
        self._data.geom_xmat[:] = xmat.reshape(-1, 9)
        box = self._model.geom_aabb
        centre = np.einsum("gij,gj->gi", xmat, box[:, :3]) + xpos
        half = np.einsum("gij,gj->gi", np.abs(xmat), box[:, 3:])
        self.low, self.high = centre - half, centre + half

    def extent(self, part: int) -> tuple[NDArray, NDArray]:
        """Return the lowest and highest corner of a part's bounding box in the present pose [m]."""
        owned = self.owner == part
        return self.low[owned].min(axis=0), self.high[owned].max(axis=0)

    def nearest(self, first: NDArray, second: NDArray, reach: float) -> PieceDistance | None:
        """Return the pair of pieces with the smallest signed distance, one from each of two sets.

        Args:
            first: indices of the pieces of the first set, shape [n].
            second: indices of the pieces of the second set, shape [m].
            reach: largest distance [m], above 0.

        Returns:
            The pair, or None if no pair lies within `reach`.
        """
        closest: PieceDistance | None = None
        low_1, high_1 = self.low[first].min(axis=0) - reach, self.high[first].max(axis=0) + reach
        second = second[np.all((self.low[second] <= high_1) & (self.high[second] >= low_1), axis=1)]
        for a in first:
            gaps = np.maximum(self.low[second] - self.high[a], self.low[a] - self.high[second])
            for b in second[np.all(gaps <= reach, axis=1)]:
                distance = geom_distance(self._model, self._data, int(a), int(b), reach)
                if distance < reach and (closest is None or distance < closest.distance):
                    closest = PieceDistance(int(a), int(b), distance)
            self.check_time()
        return closest

    def separation(self, first: int, second: int, reach: float = 10.0) -> tuple[float, NDArray]:
        """Return the signed distance between two parts, and the direction in which they separate.

        Args:
            first: index of the first part.
            second: index of the second part.
            reach: largest distance that is measured [m].

        Returns:
            The distance [m], at most `reach`, and the unit vector from the first part to the
            second, shape [3]. If the distance exceeds `reach` or is 0, the vector points up.
        """
        up = np.array([0.0, 0.0, 1.0])
        closest = self.nearest(self.of_part(first), self.of_part(second), reach)
        if closest is None:
            return reach, up
        ends = np.zeros(6)
        distance = mujoco.mj_geomDistance(
            self._model, self._data, closest.first, closest.second, reach, ends
        )
        offset = ends[3:] - ends[:3]
        length = float(np.linalg.norm(offset))
        if length < 1e-9:
            return distance, up
        # If the pieces penetrate each other, the segment between the two points is reversed.
        return distance, offset / length * (1.0 if distance >= 0 else -1.0)

    def of_part(self, part: int) -> NDArray:
        """Return the indices of the pieces of a part."""
        return np.flatnonzero(self.owner == part)

    def depths(
        self, pairs: Iterable[tuple[int, int]], reach: float = 1e-6
    ) -> dict[tuple[int, int], PieceDistance]:
        """Return the nearest pair of pieces for every pair of parts that touch or overlap.

        Args:
            pairs: pairs of part indices.
            reach: largest distance [m] at which two parts count as touching.
        """
        self.check_time()
        part_pairs = np.array(list(pairs), dtype=int).reshape(-1, 2)
        # Pieces are ordered by part, so each part is one slice.
        low = np.minimum.reduceat(self.low, self._first) - reach
        high = np.maximum.reduceat(self.high, self._first)
        first, second = part_pairs.T
        overlapping = np.all((low[first] <= high[second]) & (low[second] <= high[first]), axis=1)
        deepest = {}
        for a, b in part_pairs[overlapping].tolist():
            closest = self.nearest(self.of_part(a), self.of_part(b), reach)
            if closest is not None:
                deepest[a, b] = closest
        return deepest


def line_box_distance(point: NDArray, axis: NDArray, low: NDArray, high: NDArray) -> float:
    """Return the margin [m] by which a box must grow on all sides to intersect a line.

    Args:
        point: a point of the line [m], shape [3].
        axis: direction of the line, shape [3].
        low: lowest corner of the box [m], shape [3].
        high: highest corner of the box [m], shape [3].
    """
    smallest, largest = 0.0, float(np.abs(np.concatenate([low - point, high - point])).max()) + 1.0
    for _ in range(40):
        grow = (smallest + largest) / 2
        a, b = low - grow - point, high + grow - point
        inside = np.where((a <= 0) & (b >= 0), np.inf, -np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            near = np.where(axis == 0, -inside, np.minimum(a / axis, b / axis))
            far = np.where(axis == 0, inside, np.maximum(a / axis, b / axis))
        if near.max() <= far.min():
            largest = grow
        else:
            smallest = grow
    return largest if largest > 1e-9 else 0.0

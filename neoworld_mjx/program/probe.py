"""Exact distances between the parts of one object, in any state of its joints.

MuJoCo's contact list leaves out parents and children; `mj_geomDistance` leaves out nothing. The
model here has no bodies and no physics: every convex piece is a geom of the world that is put where
the joints carry it.
"""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..spec import ObjectSpec, link_poses, pieces
from ..spec.pose import rotate

_TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}

CONCENTRIC_M = 1e-5
_NUDGE = np.array([0.36, 0.48, 0.80]) * 1e-5
"""MuJoCo 3.17 calls two geoms 0 m apart when their centres coincide; this far off it does not."""


class OutOfTime(Exception):
    """The object is too intricate to be measured in the time allowed."""


@dataclass(frozen=True)
class Near:
    """Two pieces and the signed distance between them [m]; negative is depth."""

    first: int
    second: int
    distance: float


class Probe:
    """An object's pieces, placed and measured.

    Args:
        spec: the object.
        seconds: of processor time after which measuring gives up.
    """

    def __init__(self, spec: ObjectSpec, seconds: float = float("inf")) -> None:
        self.spec = spec
        self._until = time.thread_time() + seconds
        self.names = [part.name for part in spec.parts]
        world = mujoco.MjSpec()
        owner: list[int] = []
        geom: list[int] = []
        order = [g.name for part in spec.parts for g in part.geoms]
        for index, part in enumerate(spec.parts):
            for placed, piece, at in pieces(part):
                made = world.worldbody.add_geom(
                    type=_TYPES[piece.kind], size=piece.size, pos=at.pos, quat=at.quat
                )
                if piece.kind == "mesh":
                    made.meshname = f"m{len(owner)}"
                    mesh = world.add_mesh(name=made.meshname)
                    mesh.uservert = np.array(piece.vertices).ravel()
                    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
                owner.append(index)
                geom.append(order.index(placed.name))
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
        """Give up when the time allowed is over.

        Raises:
            OutOfTime: it is.
        """
        if time.thread_time() > self._until:
            raise OutOfTime

    def place(self, joint_state: Mapping[str, float]) -> None:
        """Put every piece where the joints carry it; joints not named stand at 0."""
        self.check_time()
        moved = link_poses(self.spec, dict(joint_state))
        quats = np.array([moved[name].quat for name in self.names])
        turn = rotate(quats[:, None], np.eye(3)).swapaxes(1, 2)[self.owner]
        shift = np.array([moved[name].pos for name in self.names])[self.owner]
        xpos = np.einsum("gij,gj->gi", turn, self._rest_pos) + shift
        xmat = turn @ self._rest_mat
        self._data.geom_xpos[:] = xpos
        self._data.geom_xmat[:] = xmat.reshape(-1, 9)
        box = self._model.geom_aabb
        centre = np.einsum("gij,gj->gi", xmat, box[:, :3]) + xpos
        half = np.einsum("gij,gj->gi", np.abs(xmat), box[:, 3:])
        self.low, self.high = centre - half, centre + half

    def extent(self, part: int) -> tuple[NDArray, NDArray]:
        """Return the bounding box (low [3], high [3]) [m] of a part as placed."""
        own = self.owner == part
        return self.low[own].min(axis=0), self.high[own].max(axis=0)

    def nearest(self, first: NDArray, second: NDArray, reach: float) -> Near | None:
        """Find the deepest or nearest pair of two sets of pieces; None if all are beyond `reach`.

        Args:
            first: indices of pieces.
            second: indices of pieces.
            reach: distance [m] beyond which nothing is looked for, above 0.
        """
        found: Near | None = None
        low_1, high_1 = self.low[first].min(axis=0) - reach, self.high[first].max(axis=0) + reach
        second = second[np.all((self.low[second] <= high_1) & (self.high[second] >= low_1), axis=1)]
        for a in first:
            gaps = np.maximum(self.low[second] - self.high[a], self.low[a] - self.high[second])
            for b in second[np.all(gaps <= reach, axis=1)]:
                distance = self.distance(int(a), int(b), reach)
                if distance < reach and (found is None or distance < found.distance):
                    found = Near(int(a), int(b), distance)
            self.check_time()
        return found

    def distance(self, a: int, b: int, reach: float) -> float:
        """Return the signed distance [m] of two pieces, `reach` if they are further apart."""
        xpos = self._data.geom_xpos
        if np.abs(xpos[a] - xpos[b]).max() > CONCENTRIC_M:
            return mujoco.mj_geomDistance(self._model, self._data, a, b, reach, None)
        kept = xpos[b].copy()
        xpos[b] = xpos[a] + _NUDGE
        found = mujoco.mj_geomDistance(self._model, self._data, a, b, reach, None)
        xpos[b] = kept
        return found

    def separation(self, first: int, second: int, reach: float = 10.0) -> tuple[float, NDArray]:
        """Return the signed distance of two parts [m] and the unit vector [3] from first to second.

        Beyond `reach`, and where two pieces only touch, the vector points up.
        """
        up = np.array([0.0, 0.0, 1.0])
        near = self.nearest(self.of_part(first), self.of_part(second), reach)
        if near is None:
            return reach, up
        ends = np.zeros(6)
        distance = mujoco.mj_geomDistance(
            self._model, self._data, near.first, near.second, reach, ends
        )
        offset = ends[3:] - ends[:3]
        length = float(np.linalg.norm(offset))
        if length < 1e-9:
            return distance, up
        # The two ends of a penetration lie behind each other.
        return distance, offset / length * (1.0 if distance >= 0 else -1.0)

    def of_part(self, part: int) -> NDArray:
        """Return the indices of a part's pieces."""
        return np.flatnonzero(self.owner == part)

    def depths(
        self, pairs: NDArray | Iterable[tuple[int, int]], reach: float = 1e-6
    ) -> dict[tuple[int, int], Near]:
        """Return the deepest pair of pieces of every two parts that touch or overlap.

        Args:
            pairs: of parts, [n, 2].
            reach: distance [m] that counts as touching.
        """
        self.check_time()
        given = np.array(pairs if isinstance(pairs, np.ndarray) else list(pairs), dtype=int)
        if not len(given):
            return {}
        # Pieces are in the order of their parts.
        low = np.minimum.reduceat(self.low, self._first) - reach
        high = np.maximum.reduceat(self.high, self._first)
        one, two = given.T
        near_by = np.all((low[one] <= high[two]) & (low[two] <= high[one]), axis=1)
        found = {}
        for a, b in given[near_by].tolist():
            near = self.nearest(self.of_part(a), self.of_part(b), reach)
            if near is not None:
                found[a, b] = near
        return found


def line_box_distance(point: NDArray, axis: NDArray, low: NDArray, high: NDArray) -> float:
    """Return by how much [m] a box must grow on all sides until a line meets it."""
    least, most = 0.0, float(np.abs(np.concatenate([low - point, high - point])).max()) + 1.0
    for _ in range(40):
        grow = (least + most) / 2
        a, b = low - grow - point, high + grow - point
        inside = np.where((a <= 0) & (b >= 0), np.inf, -np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            near = np.where(axis == 0, -inside, np.minimum(a / axis, b / axis))
            far = np.where(axis == 0, inside, np.maximum(a / axis, b / axis))
        if near.max() <= far.min():
            most = grow
        else:
            least = grow
    return most if most > 1e-9 else 0.0

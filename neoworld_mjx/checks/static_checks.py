"""Static checks of an object: masses, inertias, friction and colliders; and a probe of distances.

`Probe` measures exact distances between the parts of an object in any joint state. MuJoCo's contact
list omits pairs of parent and child, but `mj_geomDistance` measures every pair. The model has no
dynamics: every convex piece is a geom of the world body, and its pose is set from the object's
kinematics.
"""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.colliders import geom_distance
from ..physics.mjcf import GEOM_TYPES
from ..spec import ObjectSpec, PartSpec, inertial, link_poses, part_bounds, pieces
from ..spec.convex import Piece, mass_properties, planes
from ..spec.pose import Pose, rotate
from ..spec.shapes import HELPER, UNKNOWN
from .verdict import Check, Fault, Limit, make_check

MASS_RATIO = 10.0
"""Largest ratio of an authored mass to the mass from volume and density.

The smallest ratio is 1 / MASS_RATIO^2.
"""
DENSEST, LIGHTEST = 22000.0, 0.5
"""Largest and smallest mass over collider volume [kg/m^3].

The largest is close to the density of osmium, and the smallest is below the density of any foam.
"""
HEAVIEST_KG = 2000.0
SLIPPERIEST, ROUGHEST = 0.09, 1.75
"""Friction with which an object begins to slide on a slope of 5 and of 60 degrees."""
INERTIA_RATIO = 30.0
"""Largest ratio of the inertia from volume and density to an authored inertia.

The smallest ratio is 3 / INERTIA_RATIO.
"""
FARTHEST_M, TOUCH_M = 10.0, 1e-6
"""Largest distance of two parts that is measured, and largest one at which they touch [m]."""
SURFACE_SAMPLES = 240
"""Number of points that are sampled on a part's visible surface."""
MAX_UNCOVERED_FRACTION = 0.2
"""Largest fraction of a part's visible surface without a collider."""
MAX_COLLIDER_EXCESS = 0.04
"""Largest distance by which colliders exceed the visible shape, over the visible diagonal."""


def check_statics(spec: ObjectSpec) -> Iterator[Check]:
    """Yield checks of authored inertias and masses, the total mass, friction and colliders."""
    for part in spec.parts:
        yield from _inertia(spec, part)
    total = 0.0
    for part in spec.parts:
        total += part.mass if part.mass is not None else inertial(spec, part).mass
        yield from _mass(spec, part)
    limit = Limit(HEAVIEST_KG, "kg", Fault.MASS_IMPLAUSIBLE)
    yield make_check("static", "mass", total, limit)
    colliding = {g.material for part in spec.parts for g in part.geoms if g.role != "visual"}
    for material in spec.materials:
        if material.name not in colliding:
            continue
        low = material.friction < SLIPPERIEST
        limit = Limit(SLIPPERIEST if low else ROUGHEST, "", Fault.FRICTION_IMPLAUSIBLE, least=low)
        yield make_check("static", f"friction:{material.name}", material.friction, limit)
    for part in spec.parts:
        yield from _colliders(spec, part)


def is_placeholder(part: PartSpec) -> bool:
    """Return True if a part stands for a link without colliders.

    A placeholder collides with nothing, and represents the mass and inertia of a body whose extent
    is unknown.
    """
    colliding = [geom for geom in part.geoms if geom.role != "visual"]
    return all(geom.material.startswith(HELPER) for geom in colliding)


def _inertia(spec: ObjectSpec, part: PartSpec) -> Iterator[Check]:
    """Check that an authored inertia is physical and fits the part.

    The center of mass must lie inside the part's bounding box, within a tolerance.
    """
    if part.inertia is None or part.mass is None:
        return
    moments = np.sort(np.linalg.eigvalsh(part.inertia.tensor()))
    # The largest principal moment is at most the sum of the others.
    violation = float(max(-moments[0], moments[2] - moments[0] - moments[1], 0.0))
    size = max(abs(float(moments[2])), 1e-30)
    positive = moments[0] > 0
    value = violation / size if positive else np.inf
    limit = Limit(0.02, "", Fault.INERTIA_IMPOSSIBLE)
    yield make_check("static", f"moments:{part.name}", value, limit, part=part.name)
    if is_placeholder(part):
        return
    derived = inertial(spec, part.model_copy(update={"inertia": None}))
    ratio = max(derived.diagonal) / size if positive else np.inf
    limit = Limit(INERTIA_RATIO, "times", Fault.INERTIA_IMPOSSIBLE)
    yield make_check("static", f"spread:{part.name}", max(ratio, 3 / ratio), limit, part=part.name)
    low, high = part_bounds(spec, part)
    excess = float(np.maximum(low - part.inertia.pos, part.inertia.pos - high).max())
    limit = Limit(0.05 * float(np.linalg.norm(high - low)), "m", Fault.INERTIA_IMPOSSIBLE)
    yield make_check("static", f"centre:{part.name}", max(excess, 0.0), limit, part=part.name)


def _mass(spec: ObjectSpec, part: PartSpec) -> Iterator[Check]:
    """Check an authored mass against volume and density.

    If the density is unknown, check that the mass over the volume is possible for any material.
    """
    if part.mass is None or is_placeholder(part):
        return
    volume = derived = 0.0
    for geom, piece, _ in pieces(part):
        piece_volume = mass_properties(piece)[0]
        volume += piece_volume
        derived += piece_volume * spec.material(geom.material).density
    if any(geom.material.startswith(UNKNOWN) for geom, _, _ in pieces(part)):
        limit = Limit(DENSEST, "kg/m^3", Fault.MASS_IMPLAUSIBLE)
        density = part.mass / volume
        value = density if density > LIGHTEST else np.inf
    else:
        limit = Limit(MASS_RATIO, "times", Fault.MASS_IMPLAUSIBLE)
        ratio = part.mass / derived
        value = max(ratio, 1 / ratio / MASS_RATIO)
    yield make_check("static", f"mass:{part.name}", value, limit, part=part.name)


def _colliders(spec: ObjectSpec, part: PartSpec) -> Iterator[Check]:
    """Check that a part's colliders cover the visible shape, and do not exceed it by much."""
    roles = {geom.role for geom in part.geoms}
    if roles == {"both"} or roles == {"collision"} or is_placeholder(part):
        return
    points = visible_points(part)
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    lowest, highest = part_bounds(spec, part)
    excess = float(np.maximum(low - lowest, highest - high).max())
    limit = Limit(max(0.003, MAX_COLLIDER_EXCESS * size), "m", Fault.COLLIDER_LARGE)
    yield make_check(
        "static", f"colliders_out:{part.name}", max(excess, 0.0), limit, part=part.name
    )
    distances = distance_outside(points, [(piece, pose) for _, piece, pose in pieces(part)])
    uncovered = float(np.mean(distances > max(0.003, 0.03 * size)))
    limit = Limit(MAX_UNCOVERED_FRACTION, "of it", Fault.COLLIDER_MISSING)
    yield make_check("static", f"colliders_missing:{part.name}", uncovered, limit, part=part.name)


def visible_points(part: PartSpec, count: int = SURFACE_SAMPLES) -> NDArray:
    """Sample points uniformly on a part's visible surface, and add the extreme vertices.

    Returns:
        Points in the object's frame [m], shape [count + 6, 3].
    """
    corners = []
    for geom in part.geoms:
        if geom.role != "collision":
            vertices, faces = geom.shape.surface()
            corners.append(geom.pose().apply(vertices)[faces])
    triangles = np.concatenate(corners)
    a, b, c = triangles.transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    random = np.random.default_rng(0)
    chosen = random.choice(len(area), count, p=area / area.sum())
    u, v = np.sort(random.random((2, count)), axis=0)[..., None]
    inner = u * a[chosen] + (v - u) * b[chosen] + (1 - v) * c[chosen]
    # With the extreme vertices, the points span the full extent.
    flat = triangles.reshape(-1, 3)
    return np.concatenate([inner, flat[flat.argmin(axis=0)], flat[flat.argmax(axis=0)]])


def distance_outside(points: NDArray, solids: Sequence[tuple[Piece, Pose]]) -> NDArray:
    """Return a lower bound of the distance from each point to the nearest convex piece.

    For a piece with faces, the bound is the largest signed distance to the plane of a face.

    Args:
        points: points [m], shape [n, 3].
        solids: convex pieces with their poses.

    Returns:
        Distances [m], shape [n]; negative inside a piece.
    """
    nearest = np.full(len(points), np.inf)
    for piece, pose in solids:
        local = pose.inverse().apply(points)
        s = np.array(piece.size)
        if piece.kind in ("box", "mesh"):
            faces = planes(piece)
            distance = (local @ faces[:, :3].T - faces[:, 3]).max(axis=1)
        elif piece.kind == "sphere":
            distance = np.linalg.norm(local, axis=1) - s[0]
        elif piece.kind == "ellipsoid":
            distance = (np.linalg.norm(local / s, axis=1) - 1.0) * s.min()
        elif piece.kind == "capsule":
            local[:, 2] -= np.clip(local[:, 2], -s[1], s[1])
            distance = np.linalg.norm(local, axis=1) - s[0]
        else:
            radial, axial = np.hypot(local[:, 0], local[:, 1]), np.abs(local[:, 2])
            distance = np.maximum(radial - s[0], axial - s[1])
        nearest = np.minimum(nearest, distance)
    return nearest


def without_bad_inertia(spec: ObjectSpec, checks: Sequence[Check]) -> ObjectSpec:
    """Return the object without impossible authored inertias, so that it can be simulated."""
    names = {check.part for check in checks if check.fault is Fault.INERTIA_IMPOSSIBLE}
    parts = tuple(
        part.model_copy(update={"inertia": None}) if part.name in names else part
        for part in spec.parts
    )
    return spec.model_copy(update={"parts": parts}) if names else spec


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

    def separation(self, first: int, second: int) -> tuple[float, NDArray]:
        """Return the signed distance between two parts, and the direction in which they separate.

        Args:
            first: index of the first part.
            second: index of the second part.

        Returns:
            The distance [m], at most FARTHEST_M, and the unit vector from the first part to the
            second, shape [3]. If the distance is FARTHEST_M or 0, the vector points up.
        """
        up = np.array([0.0, 0.0, 1.0])
        closest = self.nearest(self.of_part(first), self.of_part(second), FARTHEST_M)
        if closest is None:
            return FARTHEST_M, up
        ends = np.zeros(6)
        distance = mujoco.mj_geomDistance(
            self._model, self._data, closest.first, closest.second, FARTHEST_M, ends
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

    def depths(self, pairs: Iterable[tuple[int, int]]) -> dict[tuple[int, int], PieceDistance]:
        """Return the nearest pair of pieces for every pair of parts that touch or overlap.

        Args:
            pairs: pairs of part indices.
        """
        self.check_time()
        part_pairs = np.array(list(pairs), dtype=int).reshape(-1, 2)
        # Pieces are ordered by part, so each part is one slice.
        low = np.minimum.reduceat(self.low, self._first) - TOUCH_M
        high = np.maximum.reduceat(self.high, self._first)
        first, second = part_pairs.T
        overlapping = np.all((low[first] <= high[second]) & (low[second] <= high[first]), axis=1)
        deepest = {}
        for a, b in part_pairs[overlapping].tolist():
            closest = self.nearest(self.of_part(a), self.of_part(b), TOUCH_M)
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

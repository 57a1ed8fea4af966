"""Unknowns of the alignment: the camera, and the layout of every object that may move.

x = (pitch, roll, log focal length, log height; then dx, dy, yaw, log scale of each free object) are
changes of a composed scene, zero for the scene itself. A change of the focal length moves the
camera along its view (a dolly zoom), so that the image of the scene's middle stays: a wrong field
of view goes with wrong distances. As the camera stands above the origin, the scene moves instead.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ..physics.layout import Arrangement, Layout, compose_poses, frames, rotation
from ..physics.outline import is_round
from ..render import visible_surface
from ..spec import Camera, SceneObject, SceneSpec, bounds, rearranged, world_poses
from .creases import smooth_faces
from .rasterize import WorldMesh, pixels_of

CAMERA = 4
"""Number of unknowns of the camera."""
FOCAL = 2
"""Index of the logarithm of the focal length."""
EACH = 4
"""Number of unknowns of an object."""
STRETCH = 3
"""Number of nuisance unknowns of an object: logarithms of stretches along its axes."""
STEP = 1e-5
"""Step of finite differences, in m, rad or log."""


@dataclass(frozen=True)
class Placement:
    """Camera and poses at some values of the unknowns."""

    camera: Camera
    pos: Float[np.ndarray, "object 3"]
    """Origins [m]."""
    turn: Float[np.ndarray, "object 3 3"]
    """Rotations."""
    scale: Float[np.ndarray, " object"]

    def world(self, k: int, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Transform points of an object at scale 1 to the world."""
        return self.scale[k] * points @ self.turn[k].T + self.pos[k]

    def local(self, k: int, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Transform points in the world to an object at scale 1."""
        return (points - self.pos[k]) @ self.turn[k] / self.scale[k]


@dataclass(frozen=True)
class Unknowns:
    """A composed scene and its unknowns."""

    scene: SceneSpec
    camera: Camera
    free: Int[np.ndarray, " free"]
    """Indices of the objects that may move: all with a support, and furniture."""
    arrangement: Arrangement
    in_wall: Float[np.ndarray, "object 2"]
    """Horizontal direction in the wall that an object is attached to, in its support's frame; zero
    for other objects. Such an object moves along it and up: dx and dy are these two."""
    round: Bool[np.ndarray, " object"]
    """True for objects whose image does not depend on their heading."""
    lowest: Float[np.ndarray, " object"]
    """Height of each object's lowest point below or above its origin [m]."""
    middle_depth: float
    """Depth of the scene's middle along the view [m], which a dolly zoom keeps in place."""

    @classmethod
    def of(cls, scene: SceneSpec, camera: Camera) -> "Unknowns":
        """Return the unknowns of a composed scene."""
        free = [k for k, item in enumerate(scene.objects) if item.parent is not None]
        lowest = [bounds(o.spec, o.joint_state, o.base_tilt)[0][2] for o in scene.objects]
        poses = world_poses(scene)
        middles = np.array([poses[scene.objects[k].name].pos for k in free]).reshape(-1, 3)
        depth = camera.project(middles)[1] if free else np.ones(1)
        return cls(
            scene,
            camera,
            np.array(free, int),
            frames(scene),
            np.array([_direction_in_wall(scene, item) for item in scene.objects]),
            np.array([is_round(item) for item in scene.objects]),
            np.array(lowest),
            float(np.median(depth[depth > 0])) if (depth > 0).any() else 1.0,
        )

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return CAMERA + EACH * len(self.free)

    @cached_property
    def surfaces(self) -> list[WorldMesh]:
        """Visible surface of each object in its frame."""
        surfaces = (visible_surface(o.spec, o.joint_state) for o in self.scene.objects)
        return [WorldMesh(*surface, smooth_faces(*surface)) for surface in surfaces]

    def mesh(self, place: Placement, k: int) -> WorldMesh:
        """Return the visible surface of an object in the world."""
        surface = self.surfaces[k]
        return surface._replace(vertices=place.world(k, surface.vertices))

    def columns(self, k: int) -> slice:
        """Return the indices of a free object's unknowns."""
        first = CAMERA + EACH * int(np.flatnonzero(self.free == k)[0])
        return slice(first, first + EACH)

    def layout(self, x: Float[np.ndarray, "batch u"]) -> Layout:
        """Return the objects' unknowns as layouts."""
        values = np.zeros((len(x), len(self.scene.objects), EACH))
        values[:, self.free] = x[:, CAMERA:].reshape(len(x), -1, EACH)
        on_wall = self.in_wall.any(axis=1, keepdims=True)
        xy = np.where(on_wall, values[..., :1] * self.in_wall, values[..., :2])
        return Layout(xy, values[..., 2], values[..., 3])

    def heights(
        self, x: Float[np.ndarray, "batch u"], layout: Layout
    ) -> Float[np.ndarray, "batch object"]:
        """Return the height of each origin above its support frame [m].

        Supports are taken as flat, so an object keeps its clearance above its support, which grows
        with its parent; settling corrects what remains.
        """
        a = self.arrangement
        size = np.exp(np.asarray(layout.log_scale))
        parent = np.where(a.parent >= 0, size[:, np.maximum(a.parent, 0)], 1.0)
        fixed = np.array([item.relation == "attached" for item in self.scene.objects])
        up = np.zeros((len(x), len(fixed)))
        up[:, self.free] = x[:, CAMERA + 1 :: EACH]
        up = np.where(self.in_wall.any(axis=1), up, 0.0)
        standing = (a.z + self.lowest) * parent - self.lowest * size
        return np.where(fixed, a.z * parent + up, standing)

    def camera_at(self, x: Float[np.ndarray, " u"]) -> tuple[Camera, float]:
        """Return the camera, and how far the scene moves ahead of it [m]."""
        c = self.camera
        pitch, roll, log_focal, log_height = x[:CAMERA].tolist()
        back = self.middle_depth * math.expm1(log_focal)
        update = {
            "pitch": min(max(c.pitch + pitch, -math.pi / 2), math.pi / 2),
            "roll": c.roll + roll,
            "fovy": 2 * math.atan(math.tan(c.fovy / 2) * math.exp(-log_focal)),
            "height": c.height * math.exp(log_height) + back * math.sin(c.pitch),
        }
        return Camera.model_validate(dict(c) | update), back * math.cos(c.pitch)

    def place(self, x: Float[np.ndarray, "batch u"]) -> list[Placement]:
        """Place the scene for several values of the unknowns."""
        layout = self.layout(x)
        poses = compose_poses(self.arrangement, layout, self.heights(x, layout), np)
        placements = []
        for i, row in enumerate(x):
            camera, ahead = self.camera_at(row)
            pos, turn, scale = (
                np.asarray(value[i]) for value in (poses.pos, rotation(poses.quat, np), poses.scale)
            )
            placements.append(Placement(camera, pos + [ahead, 0.0, 0.0], turn, scale))
        return placements

    def neighbors(self, x: Float[np.ndarray, " u"]) -> list[Placement]:
        """Place the scene with every unknown increased by STEP."""
        return self.place(x + STEP * np.eye(self.size))

    def jacobian(
        self,
        now: Placement,
        neighbors: list[Placement],
        k: int,
        points: Float[np.ndarray, "n 3"],
        normal: Float[np.ndarray, "n 2"],
        width: int,
    ) -> Float[np.ndarray, "n v"]:
        """Return the derivatives of points along normals in the image.

        Args:
            now: the placement.
            neighbors: of `neighbors`, at the same unknowns.
            k: index of the object.
            points: points of the object at scale 1 [m].
            normal: directions in the image.
            width: width of the image [px].

        Returns:
            Pixels by unit of the unknowns, followed by those of STRETCH nuisance unknowns.
        """
        along = lambda p, camera: np.sum(pixels_of(camera, p, width)[0] * normal, axis=1)
        start = along(now.world(k, points), now.camera)
        result = np.zeros((len(points), self.size + STRETCH))
        for u in [*range(CAMERA), *self.columns_of(k)]:
            near = neighbors[u]
            result[:, u] = (along(near.world(k, points), near.camera) - start) / STEP
        foot = self.lowest[k] * now.turn[k][2]
        for axis in range(STRETCH):
            stretched = points.copy()
            stretched[:, axis] += STEP * (points - foot)[:, axis]
            moved = along(now.world(k, stretched), now.camera)
            result[:, self.size + axis] = (moved - start) / STEP
        return result

    def view_axes(self, now: Placement, k: int) -> Float[np.ndarray, "2 2"]:
        """Return the horizontal directions along and across the view of an object, as rows.

        They are in the frame of the object's support, as its layout is.
        """
        a = self.arrangement
        offset = (now.pos[k] - now.camera.position())[:2]
        along = offset / max(float(np.linalg.norm(offset)), 1e-6)
        # The heading of the frame is that of the composed supports, whose yaws change little.
        above = np.flatnonzero(a.ancestors[k])
        heading = float(np.sum(a.frame_yaw[above]) + np.sum(a.yaw[above[above != k]]))
        c, s = math.cos(heading), math.sin(heading)
        return np.array([along, [-along[1], along[0]]]) @ np.array([[c, -s], [s, c]])

    def columns_of(self, k: int) -> list[int]:
        """Return the indices of the unknowns that move an object: its own and its supports'."""
        above = np.flatnonzero(self.arrangement.ancestors[k])
        index = np.flatnonzero(np.isin(self.free, above))
        return (CAMERA + EACH * index[:, None] + np.arange(EACH)).ravel().tolist()

    def scene_at(self, x: Float[np.ndarray, " u"]) -> SceneSpec:
        """Return the scene with its camera at some values of the unknowns."""
        layout = self.layout(x[None])
        camera, ahead = self.camera_at(x)
        height = self.heights(x[None], layout)[0]
        xy, yaw, log_scale = (
            np.asarray(value[0]) for value in (layout.xy, layout.yaw, layout.log_scale)
        )
        scene = rearranged(self.scene, xy, yaw, log_scale, height)
        objects = [
            item
            if item.parent is not None
            else item.model_copy(update={"xy": (item.xy[0] + ahead, item.xy[1])})
            for item in scene.objects
        ]
        return scene.model_copy(update={"objects": tuple(objects), "camera": camera})


def _direction_in_wall(scene: SceneSpec, item: SceneObject) -> Float[np.ndarray, " 2"]:
    """Return the horizontal direction of the wall that an object is attached to, or zero."""
    if item.relation != "attached" or item.parent is None:
        return np.zeros(2)
    low, high = bounds(scene.object(item.parent).spec)
    thinnest = int(np.argmin(np.subtract(high, low)))
    return np.zeros(2) if thinnest == 2 else np.eye(2)[1 - thinnest]

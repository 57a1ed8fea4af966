"""Unknowns of the alignment, and the camera and poses of all objects at some values of them.

The vector `x` consists of

- pitch, roll, log focal length and log height of the camera,
- dx, dy, yaw and log scale of each free object,
- with a depth image, the height of each free object above its support,
- the translation and rotation of the camera of each further photograph.

All entries are changes from the composed scene, for which `x` is zero. A change of the focal length
also moves the camera along its view (a dolly zoom), so that the image of the scene's middle does
not change: a response with a wrong field of view also has wrong distances. The camera stays above
the origin, so the scene moves instead.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ..physics.layout import Arrangement, Layout, compose_poses, frames, rotation
from ..physics.photo_view import direction_in_wall
from ..physics.placed import BALL_EXTENT
from ..physics.sampling import is_round
from ..render import visible_surface
from ..render.rasterize import DrawnObjects, WorldMesh, draw_objects
from ..spec import Camera, SceneObject, SceneSpec, bounds, with_layout, world_poses
from ..spec.pose import matrix
from .views import EACH_VIEW, ViewCamera


@dataclass(frozen=True)
class Placement:
    """Camera and poses of all objects at some values of the unknowns.

    Points of an object are in the object's frame, at scale 1.
    """

    camera: Camera
    pos: Float[np.ndarray, "object 3"]
    """Origins in the world frame [m]."""
    turn: Float[np.ndarray, "object 3 3"]
    """Rotation matrices from the object's to the world frame."""
    scale: Float[np.ndarray, " object"]
    views: tuple[Camera, ...] = ()
    """Cameras of the further photographs."""
    view: int = 0
    """Number of the photograph that `camera` took; 0 is the first one."""

    def seen_from(self, view: int) -> "Placement":
        """Return the placement with the camera of a photograph."""
        return replace(self, camera=self.views[view - 1], view=view) if view else self

    def world(self, k: int, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Transform points from the frame of object `k` to the world."""
        return self.scale[k] * points @ self.turn[k].T + self.pos[k]

    def local(self, k: int, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Transform points from the world to the frame of object `k`."""
        return (points - self.pos[k]) @ self.turn[k] / self.scale[k]


CAMERA = 4
"""Number of unknowns of the camera."""
TILT, ROLL, FOCAL = 0, 1, 2
"""Indices of the camera's pitch, its roll, and the logarithm of its focal length."""
EACH = 4
"""Number of unknowns of a free object's pose and size."""
STRETCH = 3
"""Number of nuisance unknowns of an object: the log stretches along its axes."""
UPRIGHT = math.radians(15.0)
"""Angle of a round object's axis from the vertical up to which its heading is not seen [rad]."""
STEP = 1e-5
"""Step of finite differences, in the unit of each unknown."""


@dataclass(frozen=True)
class Unknowns:
    """A composed scene and its unknowns."""

    scene: SceneSpec
    camera: Camera
    free: Int[np.ndarray, " free"]
    """Indices of the objects that may move. All of them have a parent."""
    arrangement: Arrangement
    in_wall: Float[np.ndarray, "object 2"]
    """Horizontal direction in the wall to which an object is attached, in the frame of the object's
    support; zero for other objects. For an object attached to a wall, dx is the change along this
    direction, and dy is the change of height."""
    round: Bool[np.ndarray, " object"]
    """True for objects whose image does not depend on their heading."""
    lowest: Float[np.ndarray, " object"]
    """Height of each object's lowest point relative to the object's origin [m]."""
    middle_depth: float
    """Depth of the scene's middle along the view [m]. A dolly zoom preserves the image at this
    depth."""
    rises: bool = False
    """True if the heights of free objects above their supports are unknowns."""
    views: tuple[ViewCamera, ...] = ()
    """Cameras of further photographs."""
    held: tuple[int, ...] = ()
    """Indices of the camera's unknowns that are not estimated."""

    @cached_property
    def known(self) -> tuple[int, ...]:
        """Indices of the unknowns whose value is 0: held ones, and those of `SceneObject.known`."""
        found = list(self.held)
        for k in self.free.tolist():
            known = self.scene.objects[k].known
            pose = [*range(self.size)[self.columns(k)], *self.rise_columns(k)]
            found += {"pose": pose, "size": [self.columns(k).stop - 1], None: []}[known]
        return tuple(found)

    @classmethod
    def of(
        cls,
        scene: SceneSpec,
        camera: Camera,
        *,
        only: Collection[str] | None = None,
        rises: bool = False,
        views: tuple[ViewCamera, ...] = (),
        held: tuple[int, ...] = (),
    ) -> "Unknowns":
        """Return the unknowns of a composed scene.

        Args:
            scene: the scene.
            camera: its camera.
            only: names of the objects that may move; if None, all objects with a parent may.
            rises: if True, heights above supports are unknowns.
            views: cameras of further photographs.
            held: indices of the camera's unknowns that are not estimated.
        """
        free = [
            k
            for k, item in enumerate(scene.objects)
            if item.parent is not None and (only is None or item.name in only)
        ]
        lowest = [bounds(o.spec, o.joint_state, o.base_tilt)[0][2] for o in scene.objects]
        poses = world_poses(scene)
        middles = np.array([poses[scene.objects[k].name].pos for k in free]).reshape(-1, 3)
        depth = camera.project(middles)[1] if free else np.ones(1)
        return cls(
            scene,
            camera,
            np.array(free, int),
            frames(scene),
            np.array([direction_in_wall(scene, item) for item in scene.objects]),
            np.array([_shows_no_heading(item) for item in scene.objects]),
            np.array(lowest),
            float(np.median(depth[depth > 0])) if (depth > 0).any() else 1.0,
            rises,
            views,
            held,
        )

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.first_view + EACH_VIEW * len(self.views)

    @property
    def first_view(self) -> int:
        """Index of the first unknown of a further camera."""
        return self.first_rise + (len(self.free) if self.rises else 0)

    def view_columns(self, view: int) -> list[int]:
        """Return the indices of the unknowns of a further camera; empty for the first one."""
        first = self.first_view + EACH_VIEW * (view - 1)
        return [*range(first, first + EACH_VIEW)] if view else []

    @property
    def size_with_stretches(self) -> int:
        """Number of all unknowns, including the stretches, which are nuisance parameters."""
        return self.size + STRETCH * len(self.free)

    @property
    def first_rise(self) -> int:
        """Index of the first height above a support among the unknowns."""
        return CAMERA + EACH * len(self.free)

    def rise_columns(self, k: int) -> list[int]:
        """Return the index of the height of a free object above its support, if it is unknown."""
        if not self.rises:
            return []
        return [self.first_rise + int(i) for i in np.flatnonzero(self.free == k)]

    @cached_property
    def shorter_side(self) -> Float[np.ndarray, " object"]:
        """Shorter horizontal side of each object's bounding box, upright [m]."""
        boxes = [bounds(o.spec, o.joint_state) for o in self.scene.objects]
        return np.array([min(np.subtract(high, low)[:2]) for low, high in boxes])

    @cached_property
    def surfaces(self) -> list[WorldMesh]:
        """Visible surface of each object, in the object's frame."""
        items = self.scene.objects
        return [WorldMesh(*visible_surface(item.spec, item.joint_state)) for item in items]

    def mesh(self, place: Placement, k: int) -> WorldMesh:
        """Return an object's visible surface in the world."""
        surface = self.surfaces[k]
        return surface._replace(vertices=place.world(k, surface.vertices))

    def draw(self, place: Placement, width: int) -> DrawnObjects:
        """Render the scene in a placement."""
        meshes = [self.mesh(place, k) for k in range(len(self.surfaces))]
        return draw_objects(meshes, place.camera, width)

    def columns(self, k: int) -> slice:
        """Return the indices of the unknowns of a free object's pose and size."""
        first = CAMERA + EACH * int(np.flatnonzero(self.free == k)[0])
        return slice(first, first + EACH)

    def stretch_columns(self, k: int) -> list[int]:
        """Return the indices of the stretches of a free object."""
        own = int(np.flatnonzero(self.free == k)[0])
        return [self.size + STRETCH * own + axis for axis in range(STRETCH)]

    def is_size(self, u: int) -> bool:
        """Return whether an unknown is the size of an object."""
        return CAMERA <= u < self.first_rise and (u - CAMERA) % EACH == EACH - 1

    def layout(self, x: Float[np.ndarray, "batch u"]) -> Layout:
        """Return the unknowns of all objects as a batch of layouts."""
        values = np.zeros((len(x), len(self.scene.objects), EACH))
        own = x[:, CAMERA : self.first_rise]
        values[:, self.free] = own.reshape(len(x), -1, EACH)
        on_wall = self.in_wall.any(axis=1, keepdims=True)
        xy = np.where(on_wall, values[..., :1] * self.in_wall, values[..., :2])
        return Layout(xy, values[..., 2], values[..., 3])

    def heights(
        self, x: Float[np.ndarray, "batch u"], layout: Layout
    ) -> Float[np.ndarray, "batch object"]:
        """Return the height of each object's origin above the object's support frame [m].

        Supports are assumed to be flat, so the height of an object's lowest point scales with the
        size of the object's parent. Settling corrects the remaining errors.
        """
        a = self.arrangement
        size = np.exp(np.asarray(layout.log_scale))
        parent = np.where(a.parent >= 0, size[:, np.maximum(a.parent, 0)], 1.0)
        fixed = np.array([item.relation == "attached" for item in self.scene.objects])
        up = np.zeros((len(x), len(fixed)))
        up[:, self.free] = x[:, CAMERA + 1 : self.first_rise : EACH]
        up = np.where(self.in_wall.any(axis=1), up, 0.0)
        standing = (a.z + self.lowest) * parent - self.lowest * size
        heights = np.where(fixed, a.z * parent + up, standing)
        if self.rises:
            heights[:, self.free] += x[:, self.first_rise : self.first_view]
        return heights

    def camera_at(self, x: Float[np.ndarray, " u"]) -> tuple[Camera, float]:
        """Return the camera, and the shift of the scene along the world's x axis [m]."""
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
        """Return the placement of the scene for each row of `x`."""
        layout = self.layout(x)
        poses = compose_poses(self.arrangement, layout, self.heights(x, layout), np)
        placements = []
        for i, row in enumerate(x):
            camera, ahead = self.camera_at(row)
            pos, turn, scale = (
                np.asarray(value[i]) for value in (poses.pos, rotation(poses.quat, np), poses.scale)
            )
            pos = pos + [ahead, 0.0, 0.0]
            placements.append(Placement(camera, pos, turn, scale, self._views(row, camera, ahead)))
        return placements

    def _views(
        self, row: Float[np.ndarray, " u"], first: Camera, ahead: float
    ) -> tuple[Camera, ...]:
        """Return the cameras of the further photographs."""
        changes = row[self.first_view :].reshape(-1, EACH_VIEW)
        log_focal = float(row[FOCAL])
        return tuple(
            view.at(first, ahead, log_focal, change)
            for view, change in zip(self.views, changes, strict=True)
        )

    def neighbors(self, x: Float[np.ndarray, " u"]) -> list[Placement]:
        """Return one placement for each unknown, in which this unknown is increased by STEP."""
        return self.place(x + STEP * np.eye(self.size))

    def view_axes(self, now: Placement, k: int) -> Float[np.ndarray, "2 2"]:
        """Return horizontal unit vectors along and across the line of sight to an object, as rows.

        The vectors are in the frame of the object's support, like the object's layout.
        """
        offset = (now.pos[k] - now.camera.position())[:2]
        along = offset / max(float(np.linalg.norm(offset)), 1e-6)
        return self.in_support_frame(k, np.array([along, [-along[1], along[0]]]))

    def in_support_frame(
        self, k: int, vectors: Float[np.ndarray, "*n 2"]
    ) -> Float[np.ndarray, "*n 2"]:
        """Rotate horizontal vectors from the world into the frame of an object's support."""
        a = self.arrangement
        # The composed headings of the supports are used, because they change little.
        above = np.flatnonzero(a.ancestors[k])
        heading = float(np.sum(a.frame_yaw[above]) + np.sum(a.yaw[above[above != k]]))
        c, s = math.cos(heading), math.sin(heading)
        return vectors @ np.array([[c, -s], [s, c]])

    def columns_of(self, k: int) -> list[int]:
        """Return the indices of the unknowns of an object and of all its supports.

        If heights above supports are unknown, the sizes of the supports are omitted: otherwise a
        support would grow to raise an object.
        """
        above = np.flatnonzero(self.arrangement.ancestors[k])
        index = np.flatnonzero(np.isin(self.free, above))
        places = (CAMERA + EACH * index[:, None] + np.arange(EACH)).ravel().tolist()
        if self.rises:
            own = self.columns(k).stop - 1 if k in self.free else -1
            places = [u for u in places if u == own or not self.is_size(u)]
        return places + [u for other in above.tolist() for u in self.rise_columns(other)]

    def values_of(self, scene: SceneSpec) -> Float[np.ndarray, " u"]:
        """Return the values at which camera and objects are where another scene has them.

        Args:
            scene: the same objects on the same supports, at other places and sizes.
        """
        x, before, after = np.zeros(self.size), self.camera, scene.camera or self.camera
        x[:CAMERA] = (
            after.pitch - before.pitch,
            after.roll - before.roll,
            math.log(after.focal / before.focal),
            math.log(after.height / before.height),
        )
        for k in self.free[~self.in_wall[self.free].any(axis=1)].tolist():
            item = self.scene.objects[k]
            other = scene.object(item.name)
            sizes = [np.linalg.norm(np.subtract(*bounds(o.spec))) for o in (other, item)]
            turn = math.remainder(other.yaw - item.yaw, 2 * math.pi)
            shift = np.subtract(other.xy, item.xy)
            x[self.columns(k)] = (*shift, turn, math.log(sizes[0] / sizes[1]))
        return x

    def scene_at(self, x: Float[np.ndarray, " u"]) -> SceneSpec:
        """Return the scene, with its camera, at the values `x` of the unknowns."""
        layout = self.layout(x[None])
        camera, ahead = self.camera_at(x)
        height = self.heights(x[None], layout)[0]
        xy, yaw, log_scale = (
            np.asarray(value[0]) for value in (layout.xy, layout.yaw, layout.log_scale)
        )
        scene = with_layout(self.scene, xy, yaw, log_scale, height)
        objects = [
            item
            if item.parent is not None
            else item.model_copy(update={"xy": (item.xy[0] + ahead, item.xy[1])})
            for item in scene.objects
        ]
        return scene.model_copy(update={"objects": tuple(objects), "camera": camera})


def _shows_no_heading(item: SceneObject) -> bool:
    """Return whether the image of an object does not depend on its heading.

    That is so for a round object that stands upright, and for a ball. The heading of a round object
    that lies or leans is that of its axis.
    """
    if not is_round(item):
        return False
    size = np.subtract(*bounds(item.spec, item.joint_state)[::-1])
    upright = abs(matrix(np.array(item.base_tilt))[2, 2]) > math.cos(UPRIGHT)
    return bool(upright or np.ptp(size) < BALL_EXTENT * size.max())

"""Nodes of a scene on the page: parts, colliders, contacts, and the photograph."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...render.part_meshes import PartMesh, piece_meshes, visible_meshes
from ...spec import Camera, SceneSpec, link_poses, world_poses
from ...spec.pose import Pose, from_matrix
from .part_glb import detail_of, part_glb

NEAR_M = 0.06
"""Distance from the camera to the plane on which the photograph is shown [m]."""
TOUCHING, DEEP = (70, 200, 90), (235, 60, 50)
PENETRATION_M = 1e-3
"""Depth above which a contact is marked as a penetration [m]."""
TRANSPARENT_OPACITY = 0.3
"""Opacity of objects while contacts are shown."""

PartPoses = dict[tuple[str, str], Pose]
"""Pose of each part, by object and part: the transform that maps points of the part from the
object's frame, with all joints at zero, to the world frame."""


def part_poses(scene: SceneSpec) -> PartPoses:
    """Return the pose of each part at the scene's poses and joint states."""
    poses = world_poses(scene)
    return {
        (obj.name, part): poses[obj.name].then(part_pose)
        for obj in scene.objects
        for part, part_pose in link_poses(obj.spec, obj.joint_state).items()
    }


class SceneNodes:
    """Nodes of one scene on a page."""

    def __init__(self, server: Any, picked: Callable[[str], None]):
        """Create an empty page.

        Args:
            server: the viser server.
            picked: function that receives the name of a clicked object.
        """
        self._server, self._picked = server, picked
        self._frames: dict[tuple[str, str], Any] = {}
        self._shown: PartPoses = {}
        self._visible: list[Any] = []
        self._transparent_copies: list[Any] = []
        self._clickable = self._surfaces = True
        self._transparent = False
        self._pieces: list[Any] = []
        self._contacts: list[Any] = []
        self._photo: Any = None
        self._picture: NDArray | None = None
        self.scene: SceneSpec | None = None

    def show(self, scene: SceneSpec) -> None:
        """Replace the shown scene."""
        api = self._server.scene
        old = {} if self.scene is None else {obj.name: obj.spec for obj in self.scene.objects}
        new = {obj.name: obj.spec for obj in scene.objects}
        with self._server.atomic():
            for key in [key for key in self._frames if old[key[0]] is not new.get(key[0])]:
                self._frames.pop(key).remove()
                self._shown.pop(key, None)
            self._visible = [h for h in self._visible if self._exists(h)]
            self.hide_pieces()
            for node in self._transparent_copies:
                if self._exists(node):
                    node.remove()
            self._transparent_copies = []
            self.scene, unchanged, poses = scene, len(self._visible), part_poses(scene)
            detail = detail_of(scene, _distance(scene, poses))
            for obj in scene.objects:
                for part in obj.spec.parts:
                    if (obj.name, part.name) in self._frames:
                        continue
                    path = f"/scene/{obj.name}/{part.name}"
                    key = obj.name, part.name
                    self._frames[key] = api.add_frame(path, show_axes=False)
                    glb = part_glb(obj.spec, part, poses[key].quat, detail)
                    if glb is not None:
                        self._visible.append(_add_glb(api, f"{path}/opaque", glb))
                    for k, mesh in enumerate(visible_meshes(obj.spec, part, opaque=False)):
                        self._visible.append(_add_mesh(api, f"{path}/{k}", mesh))
            for node in self._visible[unchanged:]:
                self._pickable(node, node.name.split("/")[2])
            self.pose(poses)
            self._update_surfaces()

    def pose(self, poses: PartPoses) -> None:
        """Move the parts whose pose has changed."""
        with self._server.atomic():
            for key, pose in poses.items():
                before = self._shown.get(key)
                if before is not None and _same(before, pose):
                    continue
                frame = self._frames[key]
                frame.position, frame.wxyz = pose.pos, pose.quat
                self._shown[key] = pose

    @property
    def poses(self) -> PartPoses:
        """Poses of the shown parts."""
        return dict(self._shown)

    def show_visible(self, visible: bool) -> None:
        """Show or hide the visible surfaces."""
        self._surfaces = visible
        self._update_surfaces()

    def set_transparent(self, transparent: bool) -> None:
        """Make objects transparent, to reveal contacts inside them, or opaque again."""
        self._transparent = transparent
        self._update_surfaces()

    def _update_surfaces(self) -> None:
        """Show the surfaces, their transparent copies, or neither; create the copies on demand."""
        clear = self._transparent and self._surfaces
        with self._server.atomic():
            if clear and not self._transparent_copies and self.scene is not None:
                for obj in self.scene.objects:
                    for part in obj.spec.parts:
                        path = f"/scene/{obj.name}/{part.name}/clear"
                        for k, mesh in enumerate(visible_meshes(obj.spec, part)):
                            mesh = mesh._replace(alpha=TRANSPARENT_OPACITY)
                            node = _add_mesh(self._server.scene, f"{path}/{k}", mesh)
                            self._pickable(node, obj.name)
                            self._transparent_copies.append(node)
            for node in self._visible:
                node.visible = self._surfaces and not self._transparent
            for node in self._transparent_copies:
                node.visible = clear

    def show_pieces(self) -> None:
        """Show the convex collision pieces, each in its own color."""
        if self.scene is None or self._pieces:
            return
        with self._server.atomic():
            for obj in self.scene.objects:
                for part in obj.spec.parts:
                    for k, mesh in enumerate(piece_meshes(part)):
                        path = f"/scene/{obj.name}/{part.name}/pieces/{k}"
                        node = _add_mesh(self._server.scene, path, mesh)
                        self._pickable(node, obj.name)
                        self._pieces.append(node)

    def hide_pieces(self) -> None:
        """Remove the convex pieces."""
        for node in self._pieces:
            if self._exists(node):
                node.remove()
        self._pieces = []

    def show_contacts(self, points: NDArray, depths: NDArray, normals: NDArray) -> None:
        """Mark contacts in green or, if their depth exceeds PENETRATION_M, in red.

        Args:
            points: contact points in the world frame [m], shape [n, 3].
            depths: penetration depths [m], shape [n]; negative for gaps.
            normals: contact normals in the world frame, shape [n, 3].
        """
        self.hide_contacts()
        if not len(points):
            return
        colors = np.where((depths > PENETRATION_M)[:, None], DEEP, TOUCHING).astype(np.uint8)
        size = 0.004 * self.extent()
        # Lines make contacts visible that lie inside both objects.
        ends = np.stack([points, points + normals * np.maximum(depths, size)[:, None] * 4], axis=1)
        api = self._server.scene
        self._contacts = [
            api.add_point_cloud(
                "/contacts/points", points, colors, point_size=size, point_shape="circle"
            ),
            api.add_line_segments(
                "/contacts/lines",
                ends,
                np.repeat(colors[:, None], 2, axis=1),
                thickness=3.0,
                thickness_units="screen",
            ),
        ]

    def hide_contacts(self) -> None:
        """Remove the marks of contacts."""
        for node in self._contacts:
            node.remove()
        self._contacts = []

    def extent(self) -> float:
        """Return the median distance of parts from the camera [m], which scales contact marks."""
        return 1.0 if self.scene is None else _distance(self.scene, self._shown)

    def blend(self, camera: Camera, picture: NDArray, share: float) -> None:
        """Blend the photograph over the scene, aligned with the view of the photograph's camera.

        Args:
            camera: camera of the photograph.
            picture: the photograph, uint8 [h, w, 3].
            share: opacity of the photograph, from 0 (scene alone) to 1 (photograph alone).
        """
        alpha = np.full((*picture.shape[:2], 1), round(255 * share), np.uint8)
        height = 2 * NEAR_M * np.tan(camera.fovy / 2)
        axes = camera.axes()
        self._photo = self._server.scene.add_image(
            "/photo",
            np.concatenate([picture, alpha], axis=2),
            height * camera.width / camera.height_px,
            height,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            wxyz=from_matrix(axes),
            position=camera.position() + NEAR_M * axes[:, 2],
            visible=share > 0,
        )

    def pickable(self, pickable: bool) -> None:
        """Enable or disable clicks on objects.

        Disable clicks while a drag handle is shown, because clickable objects in front of the
        handle would intercept the pointer.
        """
        self._clickable = pickable
        with self._server.atomic():
            for node in (*self._visible, *self._transparent_copies, *self._pieces):
                node.remove_click_callback("all")
                self._pickable(node, node.name.split("/")[2])

    def _pickable(self, node: Any, name: str) -> None:
        if self._clickable:
            node.on_click(lambda _: self._picked(name))

    def _exists(self, node: Any) -> bool:
        _, _, obj, part, *_ = node.name.split("/")
        return (obj, part) in self._frames


def look_through(client: Any, camera: Camera) -> None:
    """Move a client's view to a photograph's camera; widen the view to show the whole picture."""
    axes = camera.axes()
    view = client.camera
    window = view.image_width / max(view.image_height, 1)
    height = np.tan(camera.fovy / 2)
    picture = camera.width / camera.height_px
    if 0 < window < picture:
        height *= picture / window
    with client.atomic():
        view.fov = 2 * np.arctan(height)
        view.near = 0.01
        view.position = camera.position()
        view.wxyz = from_matrix(axes)


def look_at(client: Any, low: NDArray, high: NDArray) -> None:
    """Move a client's view to show a box, given by two corners [m], from the front and above."""
    center = (low + high) / 2
    offset = 1.8 * float(np.linalg.norm(high - low)) * np.array([0.8, -0.45, 0.42])
    with client.atomic():
        client.camera.position = center + offset
        client.camera.look_at = center


def _distance(scene: SceneSpec, poses: Mapping[tuple[str, str], Pose]) -> float:
    """Return the median distance of parts from the camera [m]."""
    eye = np.zeros(3) if scene.camera is None else scene.camera.position()
    return float(np.median([np.linalg.norm(pose.pos - eye) for pose in poses.values()] or [1.0]))


def _add_glb(api: Any, path: str, glb: bytes) -> Any:
    return api.add_glb(path, glb, cast_shadow=False, receive_shadow=False)


def _add_mesh(api: Any, path: str, mesh: PartMesh) -> Any:
    """Add a mesh of closed surfaces, without their back faces."""
    return api.add_mesh_simple(
        path,
        mesh.vertices,
        mesh.faces,
        color=mesh.rgb,
        opacity=mesh.alpha if mesh.alpha < 0.99 else None,
        cast_shadow=False,
        receive_shadow=False,
    )


def _same(a: Pose, b: Pose) -> bool:
    return bool(np.allclose(a.pos, b.pos, atol=1e-6) and np.allclose(a.quat, b.quat, atol=1e-5))


def bounds_of(scene: SceneSpec, poses: Mapping[tuple[str, str], Pose]) -> tuple[NDArray, NDArray]:
    """Return the bounds (low [3], high [3]) [m] of all visible surfaces except the environment's.

    If every object belongs to the environment, include the environment.
    """
    points = [
        poses[obj.name, part.name].apply(mesh.vertices)
        for obj in scene.objects
        if not obj.environment or all(o.environment for o in scene.objects)
        for part in obj.spec.parts
        for mesh in visible_meshes(obj.spec, part)
    ]
    vertices = np.concatenate(points)
    return vertices.min(axis=0), vertices.max(axis=0)


def light_scene(server: Any) -> None:
    """Set the vertical axis and the lights of a page; omit shadows, which double the rendering."""
    server.scene.set_up_direction("+z")
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.add_light_hemisphere("/light/sky", intensity=1.2)
    server.initial_camera.near = 0.01


def add_handle(server: Any, pose: Pose, diagonal: float) -> Any:
    """Add a handle that moves an object in the plane and turns it about the vertical.

    Args:
        server: the viser server.
        pose: initial pose of the handle in the world.
        diagonal: diagonal of the scene's bounding box [m].
    """
    return server.scene.add_transform_controls(
        "/handle",
        scale=0.35 * diagonal,
        active_axes=(True, True, False),
        disable_sliders=False,
        depth_test=False,
        rotation_limits=((0.0, 0.0), (0.0, 0.0), (-1000.0, 1000.0)),
        position=pose.pos,
        wxyz=pose.quat,
    )

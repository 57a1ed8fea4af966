"""The scene on the page: a node for each part, its colliders, contacts, and the photograph."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...render.part_meshes import PartMesh, piece_meshes, visible_meshes
from ...spec import Camera, SceneSpec, link_poses, world_poses
from ...spec.pose import Pose, from_matrix
from .part_glb import detail_of, part_glb

NEAR_M = 0.06
"""Distance of the photograph's plane in front of the camera [m]."""
TOUCHING, DEEP = (70, 200, 90), (235, 60, 50)
PENETRATION_M = 1e-3
"""Depth from which on a contact is a penetration [m]."""
CLEAR = 0.3
"""Opacity of objects while contacts are shown."""

PartPoses = dict[tuple[str, str], Pose]
"""World pose of each part's rest frame, by object and part."""


def part_poses(scene: SceneSpec) -> PartPoses:
    """Return where a scene's own poses and joint states put each part."""
    poses = world_poses(scene)
    return {
        (obj.name, part): poses[obj.name].then(moved)
        for obj in scene.objects
        for part, moved in link_poses(obj.spec, obj.joint_state).items()
    }


class ScenePage:
    """The nodes of one scene on a page."""

    def __init__(self, server: Any, picked: Callable[[str], None]):
        """Begin with nothing on the page.

        Args:
            server: of viser.
            picked: called with the name of an object that is clicked.
        """
        self._server, self._picked = server, picked
        self._frames: dict[tuple[str, str], Any] = {}
        self._shown: PartPoses = {}
        self._visible: list[Any] = []
        self._clear: list[Any] = []
        self._clickable = self._surfaces = True
        self._see_through = False
        self._pieces: list[Any] = []
        self._contacts: list[Any] = []
        self._photo: Any = None
        self._picture: NDArray | None = None
        self.scene: SceneSpec | None = None

    def show(self, scene: SceneSpec) -> None:
        """Put a scene in the place of the one before."""
        api = self._server.scene
        old = {} if self.scene is None else {obj.name: obj.spec for obj in self.scene.objects}
        new = {obj.name: obj.spec for obj in scene.objects}
        with self._server.atomic():
            for key in [key for key in self._frames if old[key[0]] is not new.get(key[0])]:
                self._frames.pop(key).remove()
                self._shown.pop(key, None)
            self._visible = [h for h in self._visible if self._is_there(h)]
            self.hide_pieces()
            for node in self._clear:
                if self._is_there(node):
                    node.remove()
            self._clear = []
            self.scene, kept, poses = scene, len(self._visible), part_poses(scene)
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
            for node in self._visible[kept:]:
                self._pickable(node, node.name.split("/")[2])
            self.pose(poses)
            self._update_surfaces()

    def pose(self, poses: PartPoses) -> None:
        """Move parts; those that stay cost nothing."""
        with self._server.atomic():
            for key, at in poses.items():
                before = self._shown.get(key)
                if before is not None and _same(before, at):
                    continue
                frame = self._frames[key]
                frame.position, frame.wxyz = at.pos, at.quat
                self._shown[key] = at

    @property
    def poses(self) -> PartPoses:
        """Where the parts are shown."""
        return dict(self._shown)

    def show_visible(self, visible: bool) -> None:
        """Show or hide what is seen of the objects."""
        self._surfaces = visible
        self._update_surfaces()

    def see_through(self, seen: bool) -> None:
        """Make objects transparent, so that contacts inside of them show, or as they are."""
        self._see_through = seen
        self._update_surfaces()

    def _update_surfaces(self) -> None:
        """Show the surfaces, their transparent copies, or neither; copies are made when asked."""
        clear = self._see_through and self._surfaces
        with self._server.atomic():
            if clear and not self._clear and self.scene is not None:
                for obj in self.scene.objects:
                    for part in obj.spec.parts:
                        path = f"/scene/{obj.name}/{part.name}/clear"
                        for k, mesh in enumerate(visible_meshes(obj.spec, part)):
                            mesh = mesh._replace(alpha=CLEAR)
                            node = _add_mesh(self._server.scene, f"{path}/{k}", mesh)
                            self._pickable(node, obj.name)
                            self._clear.append(node)
            for node in self._visible:
                node.visible = self._surfaces and not self._see_through
            for node in self._clear:
                node.visible = clear

    def show_pieces(self) -> None:
        """Show the convex pieces that collide, in colours."""
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
        """Take the convex pieces away."""
        for node in self._pieces:
            if self._is_there(node):
                node.remove()
        self._pieces = []

    def show_contacts(self, points: NDArray, depths: NDArray, normals: NDArray) -> None:
        """Mark contacts: green where two pieces touch, red where they overlap.

        Args:
            points: [n, 3] m.
            depths: overlap of each [n] m; negative is a gap.
            normals: [n, 3].
        """
        self.hide_contacts()
        if not len(points):
            return
        colours = np.where((depths > PENETRATION_M)[:, None], DEEP, TOUCHING).astype(np.uint8)
        size = 0.004 * self.extent()
        # A line makes a contact visible that lies inside of both.
        ends = np.stack([points, points + normals * np.maximum(depths, size)[:, None] * 4], axis=1)
        api = self._server.scene
        self._contacts = [
            api.add_point_cloud(
                "/contacts/points", points, colours, point_size=size, point_shape="circle"
            ),
            api.add_line_segments(
                "/contacts/lines",
                ends,
                np.repeat(colours[:, None], 2, axis=1),
                thickness=3.0,
                thickness_units="screen",
            ),
        ]

    def hide_contacts(self) -> None:
        """Take the marks of contacts away."""
        for node in self._contacts:
            node.remove()
        self._contacts = []

    def extent(self) -> float:
        """Return a length to draw marks by: the median distance of objects from the camera [m]."""
        return 1.0 if self.scene is None else _distance(self.scene, self._shown)

    def blend(self, camera: Camera, picture: NDArray, share: float) -> None:
        """Lay the photograph over the scene, as seen from its camera.

        Args:
            camera: of the photograph.
            picture: uint8 [h, w, 3].
            share: 0 shows the scene alone, 1 the photograph alone.
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
        """Let objects be clicked or not; a handle behind a clickable object cannot be dragged."""
        self._clickable = pickable
        with self._server.atomic():
            for node in (*self._visible, *self._clear, *self._pieces):
                node.remove_click_callback("all")
                self._pickable(node, node.name.split("/")[2])

    def _pickable(self, node: Any, name: str) -> None:
        if self._clickable:
            node.on_click(lambda _: self._picked(name))

    def _is_there(self, node: Any) -> bool:
        _, _, obj, part, *_ = node.name.split("/")
        return (obj, part) in self._frames


def look_through(client: Any, camera: Camera) -> None:
    """Take a client to a photograph's camera, the whole picture in view."""
    axes = camera.axes()
    view = client.camera
    window = view.image_width / max(view.image_height, 1)
    tall = np.tan(camera.fovy / 2)
    picture = camera.width / camera.height_px
    if 0 < window < picture:
        tall *= picture / window
    with client.atomic():
        view.fov = 2 * np.arctan(tall)
        view.near = 0.01
        view.position = camera.position()
        view.wxyz = from_matrix(axes)


def look_at(client: Any, low: NDArray, high: NDArray) -> None:
    """Take a client to where it sees a box [3], [3] m from its front, a little from above."""
    centre = (low + high) / 2
    away = 1.8 * float(np.linalg.norm(high - low)) * np.array([0.8, -0.45, 0.42])
    with client.atomic():
        client.camera.position = centre + away
        client.camera.look_at = centre


def _distance(scene: SceneSpec, poses: Mapping[tuple[str, str], Pose]) -> float:
    """Return the median distance of parts from the camera [m]."""
    eye = np.zeros(3) if scene.camera is None else scene.camera.position()
    return float(np.median([np.linalg.norm(at.pos - eye) for at in poses.values()] or [1.0]))


def _add_glb(api: Any, path: str, glb: bytes) -> Any:
    return api.add_glb(path, glb, cast_shadow=False, receive_shadow=False)


def _add_mesh(api: Any, path: str, mesh: PartMesh) -> Any:
    """Add a mesh; surfaces are closed, so that their insides need not be drawn."""
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
    """Return the corners of the box around all that is seen and not of the environment [m]."""
    points = [
        poses[obj.name, part.name].apply(mesh.vertices)
        for obj in scene.objects
        if not obj.environment or all(o.environment for o in scene.objects)
        for part in obj.spec.parts
        for mesh in visible_meshes(obj.spec, part)
    ]
    every = np.concatenate(points)
    return every.min(axis=0), every.max(axis=0)

"""A scene on a page: surfaces and colliders of its parts, the photograph, and free fall.

C MuJoCo simulates the scene on the page, at most as fast as real time.
"""

import threading
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..physics.mjcf import START, body_name, to_mjspec
from ..render.tiles import PartMesh, piece_meshes, visible_meshes
from ..spec import Camera, JointSpec, SceneSpec, link_poses, world_poses
from ..spec.pose import Pose, from_matrix, rotate

NEAR_M = 0.06
"""Distance from the camera to the plane on which the photograph is blended [m]."""

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
        self._surfaces: list[tuple[Any, str]] = []
        self._colliders: list[tuple[Any, str]] = []
        self._clickable = True
        self._shows_colliders = False
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map(None)
        # Shadows would double the time of a frame.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.add_light_hemisphere("/light/sky", intensity=1.2)
        server.initial_camera.near = 0.01

    def show(self, scene: SceneSpec) -> None:
        """Replace the shown scene."""
        api = self._server.scene
        with self._server.atomic():
            api.remove_by_name("/scene")
            self._frames, self._surfaces, self._colliders = {}, [], []
            for obj in scene.objects:
                for part in obj.spec.parts:
                    path = f"/scene/{obj.name}/{part.name}"
                    self._frames[obj.name, part.name] = api.add_frame(path, show_axes=False)
                    for kind, nodes, meshes in (
                        ("surface", self._surfaces, visible_meshes(obj.spec, part)),
                        ("collider", self._colliders, piece_meshes(part)),
                    ):
                        for k, mesh in enumerate(meshes):
                            nodes.append((_add_mesh(api, f"{path}/{kind}{k}", mesh), obj.name))
            self.pickable(self._clickable)
            self.show_colliders(self._shows_colliders)
            self.pose(part_poses(scene))

    def pose(self, poses: PartPoses) -> None:
        """Move the parts."""
        with self._server.atomic():
            for key, pose in poses.items():
                frame = self._frames[key]
                frame.position, frame.wxyz = pose.pos, pose.quat

    def show_colliders(self, shown: bool) -> None:
        """Show the convex collision pieces, each in its own color, instead of the surfaces."""
        self._shows_colliders = shown
        with self._server.atomic():
            for node, _ in self._surfaces:
                node.visible = not shown
            for node, _ in self._colliders:
                node.visible = shown

    def pickable(self, pickable: bool) -> None:
        """Enable or disable clicks on objects.

        Disable clicks while a drag handle is shown, because clickable objects in front of the
        handle would intercept the pointer.
        """
        self._clickable = pickable
        with self._server.atomic():
            for node, name in (*self._surfaces, *self._colliders):
                node.remove_click_callback("all")
                if pickable:
                    node.on_click(lambda _, name=name: self._picked(name))

    def blend(self, camera: Camera, picture: NDArray, share: float) -> None:
        """Blend the photograph over the scene, aligned with the view of the photograph's camera.

        Args:
            camera: camera of the photograph.
            picture: the photograph, uint8 [h, w, 3].
            share: opacity of the photograph, from 0 (scene alone) to 1 (photograph alone).
        """
        alpha = np.full((*picture.shape[:2], 1), round(255 * share), np.uint8)
        add_picture(self._server, camera, np.concatenate([picture, alpha], axis=2), NEAR_M)


def add_picture(server: Any, camera: Camera, picture: NDArray, distance: float) -> None:
    """Show a picture, uint8 [h, w, 3 or 4], on a plane that fills the view of a camera.

    Args:
        server: the viser server.
        camera: the camera.
        picture: the picture.
        distance: distance of the plane from the camera [m].
    """
    axes, height = camera.axes(), 2 * distance * np.tan(camera.fovy / 2)
    middle = np.array([-camera.principal[0], -camera.principal[1], camera.focal]) / camera.focal
    server.scene.add_image(
        "/photo",
        picture,
        height * camera.width / camera.height_px,
        height,
        format="png" if picture.shape[2] == 4 else "jpeg",
        cast_shadow=False,
        receive_shadow=False,
        wxyz=from_matrix(axes),
        position=camera.position() + distance * (axes @ middle),
    )


def look_through(client: Any, camera: Camera) -> None:
    """Move a client's view to a photograph's camera; widen the view to show the whole picture."""
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
        view.wxyz = from_matrix(camera.axes())


def look_at(client: Any, low: NDArray, high: NDArray) -> None:
    """Move a client's view to show a box, given by two corners [m], from the front and above."""
    center = (low + high) / 2
    offset = 1.8 * float(np.linalg.norm(high - low)) * np.array([0.8, -0.45, 0.42])
    with client.atomic():
        client.camera.position = center + offset
        client.camera.look_at = center


def bounds_of(scene: SceneSpec) -> tuple[NDArray, NDArray]:
    """Return the bounds (low [3], high [3]) [m] of all visible surfaces except the environment's.

    If every object belongs to the environment, include the environment.
    """
    poses = part_poses(scene)
    objects = [obj for obj in scene.objects if not obj.environment] or scene.objects
    vertices = np.concatenate(
        [
            poses[obj.name, part.name].apply(mesh.vertices)
            for obj in objects
            for part in obj.spec.parts
            for mesh in visible_meshes(obj.spec, part)
        ]
    )
    return vertices.min(axis=0), vertices.max(axis=0)


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


TIMESTEP_S = 0.004
FRAME_S = 1 / 30


class FreeFall:
    """Thread-safe simulation of a scene."""

    def __init__(self, scene: SceneSpec, on_frame: Callable[["FreeFall"], None]):
        """Compile a scene at its poses and joint states.

        Args:
            scene: the scene.
            on_frame: function to call after each frame while the simulation runs.

        Raises:
            SpecError: a part is too light to be simulated.
            ValueError: MuJoCo rejects the scene.
        """
        self.scene = scene
        self._on_frame = on_frame
        self._model = to_mjspec(scene, timestep=TIMESTEP_S).compile()
        # Otherwise MuJoCo resets a diverged simulation, which then looks stable.
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._data = mujoco.MjData(self._model)
        self._lock = threading.RLock()
        self._playing = threading.Event()
        self._thread: threading.Thread | None = None
        self._bodies = [
            ((obj.name, part.name), self._model.body(body_name(obj, part.name)).id, _origin(joint))
            for obj in scene.objects
            for part, joint in obj.spec.ordered
        ]
        self.reset()

    @property
    def playing(self) -> bool:
        """True if the simulation is running."""
        return self._playing.is_set()

    @property
    def seconds(self) -> float:
        """Simulated time [s]."""
        return float(self._data.time)

    def reset(self) -> None:
        """Reset to the initial state."""
        with self._lock:
            if self._model.nkey:
                key = self._model.key(START).id
                mujoco.mj_resetDataKeyframe(self._model, self._data, key)
            else:
                mujoco.mj_resetData(self._model, self._data)
            mujoco.mj_forward(self._model, self._data)

    def play(self) -> None:
        """Run in a thread until `pause`."""
        if self.playing:
            return
        self._playing.set()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def pause(self) -> None:
        """Stop the simulation."""
        self._playing.clear()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def step(self, seconds: float) -> None:
        """Simulate a duration [s] as fast as possible."""
        with self._lock:
            for _ in range(max(1, round(seconds / self._model.opt.timestep))):
                mujoco.mj_step(self._model, self._data)

    def poses(self) -> PartPoses:
        """Return the current pose of each part; see `PartPoses`."""
        with self._lock:
            quat = self._data.xquat.copy()
            pos = self._data.xpos.copy()
        return {
            key: Pose(pos[body] - rotate(quat[body], origin), quat[body])
            for key, body, origin in self._bodies
        }

    def _run(self) -> None:
        due = time.perf_counter()
        while self.playing:
            self.step(FRAME_S)
            if not np.isfinite(self._data.qpos).all():
                self._playing.clear()
                return
            self._on_frame(self)
            due = max(due + FRAME_S, time.perf_counter() - FRAME_S)
            time.sleep(max(0.0, due - time.perf_counter()))


def _origin(joint: JointSpec | None) -> NDArray:
    """Return the origin of a part's body in the object's frame [m]: the anchor of its joint."""
    return np.zeros(3) if joint is None else np.array(joint.pos)

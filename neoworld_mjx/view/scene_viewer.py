"""Page of `neoworld view`: a scene with its photograph, joints, colliders and free fall."""

import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..compose.layout_patch import (
    LAYOUT_PATCH,
    LayoutPatch,
    ObjectPlacement,
    read_layout_patch,
    write_layout_patch,
)
from ..errors import SpecError
from ..run_folder import read_run, verdict_line
from ..spec import (
    JointSpec,
    SceneObject,
    SceneSpec,
    bounds,
    inertial,
    joint_keys,
    support_frame,
    world_poses,
)
from ..spec.pose import Pose, from_yaw, pose, yaw_of
from .evidence_lines import deviation_phrase, evidence_lines
from .report.objects import object_checks
from .report.page import read_json
from .scene_nodes import FreeFall, SceneNodes, bounds_of, look_at, look_through, part_poses
from .server import failure, message
from .target import ViewTarget

FREE_RANGE = math.pi
"""Limit of the slider of an unlimited joint, in both directions [rad]."""


class PlacedScene:
    """A scene whose objects and joints a person moves, and the patch that records the moves."""

    def __init__(self, scene: SceneSpec, patch: LayoutPatch):
        """Start with a scene to which the patch has already been applied."""
        self.scene, self.patch = scene, patch

    def handle_pose(self, name: str) -> Pose:
        """Return the pose of a drag handle: origin and heading of its object in the world frame."""
        heading = yaw_of(self._support_frame(name).quat) + self.scene.object(name).yaw
        return pose(world_poses(self.scene)[name].pos, from_yaw(heading))

    def place(self, name: str, handle: Pose) -> None:
        """Move an object to the position and heading of its drag handle in the world frame.

        The height above the support stays unchanged.
        """
        frame = self._support_frame(name)
        x, y, _ = (float(v) for v in frame.inverse().apply(np.asarray(handle.pos, float)))
        yaw = math.remainder(yaw_of(np.asarray(handle.quat)) - yaw_of(frame.quat), 2 * math.pi)
        self._change(name, ObjectPlacement(xy=(x, y), yaw=yaw), {"xy": (x, y), "yaw": yaw})

    def set_joint(self, name: str, key: str, value: float) -> None:
        """Set one value of a joint state [rad or m]."""
        state = self.scene.object(name).joint_state | {key: value}
        self._change(name, ObjectPlacement(joint_state={key: value}), {"joint_state": state})

    def snap(self) -> None:
        """Snap every object onto its support."""
        from ..compose.on_supports import snap

        self.scene = snap(self.scene)

    def _support_frame(self, name: str) -> Pose:
        obj = self.scene.object(name)
        if obj.parent is None:
            return pose()
        parent = self.scene.object(obj.parent)
        return support_frame(parent, world_poses(self.scene)[obj.parent], obj.parent_link)

    def _change(self, name: str, placement: ObjectPlacement, update: dict[str, Any]) -> None:
        objects = tuple(
            obj.model_copy(update=update) if obj.name == name else obj for obj in self.scene.objects
        )
        self.scene = self.scene.model_copy(update={"objects": objects})
        self.patch = self.patch.merged(name, placement)


class SceneViewer:
    """Viewer of one target on the page of a server.

    Viser calls back from several threads; a lock serializes the callbacks. Each callback reads the
    current values of the controls, so the last of several changes wins.
    """

    def __init__(self, server: Any, target: ViewTarget):
        """Show a target on the page of a viser server."""
        self._server, self._target, self._lock = server, target, threading.RLock()
        self._nodes = SceneNodes(server, self.select)
        patch = LayoutPatch() if target.run is None else read_layout_patch(target.run)
        self.placed = PlacedScene(target.after, patch)
        self._fall: FreeFall | None = None
        self.handle: Any = None
        self._sliders: list[Any] = []
        self._selected = ""
        self._build_controls()
        self._show("after")
        if len(target.after.objects) == 1:
            self.select(target.after.objects[0].name)
        server.on_client_connect(self._show_home_view)

    def _build_controls(self) -> None:
        gui, target = self._server.gui, self._target
        gui.add_html(message(*verdict_of(target)))
        self._on(gui.add_button("Home view"), lambda event: self._show_home_view(event.client))
        if target.picture is not None and target.after.camera is not None:
            self._blend = gui.add_slider("Photo", 0.0, 1.0, 0.05, 0.0)
            self._on(self._blend, lambda _: self._blend_photo())
        if target.before is not None:
            self._layout = gui.add_button_group("Layout", ("before", "after"))
            self._on(self._layout, lambda _: self._show(self._layout.value))
        self._colliders = gui.add_checkbox("Colliders", False)
        self._on(self._colliders, lambda _: self._nodes.show_colliders(self._colliders.value))
        with gui.add_folder("Free fall"):
            self._play = gui.add_button("Play")
            self._on(self._play, lambda _: self._toggle_play())
            self._on(gui.add_button("Restart"), lambda _: self._restart())
            self._status = gui.add_html("")
        with gui.add_folder("Object"):
            names = [obj.name for obj in target.after.objects]
            self._chooser = gui.add_dropdown("Object", ("none", *names))
            self._on(self._chooser, lambda _: self.select(self._chooser.value))
            self._facts = gui.add_html(message("Click an object, or choose one."))
            self._drag = gui.add_checkbox("Drag", False)
            self._on(self._drag, lambda _: self._show_handle())
            if target.run is not None:
                self._on(gui.add_button("Save the placement"), lambda _: self._save())
        self._joints = gui.add_folder("Joints")

    def _on(self, control: Any, react: Callable[[Any], None]) -> None:
        """Call `react` under the lock, and show its errors, when a control changes."""

        def changed(event: Any) -> None:
            with self._lock:
                try:
                    react(event)
                except Exception as error:  # Shown on the page; nobody reads a traceback.
                    self._status.content = failure(error)

        control.on_update(changed) if hasattr(control, "on_update") else control.on_click(changed)

    def _show(self, layout: str) -> None:
        """Show the scene before or after the search."""
        self._discard_simulation()
        before = self._target.before
        scene = before if layout == "before" and before is not None else self._target.after
        self.placed = PlacedScene(scene, self.placed.patch)
        self._nodes.show(scene)
        self._show_joints()
        self._show_handle()

    def _show_home_view(self, client: Any) -> None:
        scene = self.placed.scene
        if scene.camera is not None:
            look_through(client, scene.camera)
        else:
            look_at(client, *bounds_of(scene))

    def _blend_photo(self) -> None:
        camera, picture = self._target.after.camera, self._target.picture
        assert camera is not None and picture is not None
        self._nodes.blend(camera, picture, self._blend.value)

    # Joints.

    def _show_joints(self) -> None:
        """Replace all sliders with sliders for the joints of the scene."""
        for slider in self._sliders:
            slider.remove()
        self._sliders = []
        with self._joints:
            for obj in self.placed.scene.objects:
                for joint, key in settable_joints(obj):
                    self._add_slider(obj, joint, key)
        self._joints.visible = bool(self._sliders)

    def _add_slider(self, obj: SceneObject, joint: JointSpec, key: str) -> None:
        factor, unit = (1000.0, "mm") if joint.type == "prismatic" else (math.degrees(1.0), "deg")
        # Round the limits inwards to tenths, because the page shows all digits.
        low, high = (factor * v for v in joint_range(joint))
        low, high = math.ceil(10 * low - 1e-4) / 10, math.floor(10 * high + 1e-4) / 10
        if not low < high:
            return
        now = round(min(max(factor * obj.joint_state.get(key, 0.0), low), high), 1)
        label = f"{obj.name} {key}, {unit}"
        slider = self._server.gui.add_slider(label, low, high, 0.1, now)
        self._on(slider, lambda _: self._move_joint(obj.name, key, slider.value / factor))
        self._sliders.append(slider)

    def _move_joint(self, name: str, key: str, value: float) -> None:
        self._discard_simulation()
        self.placed.set_joint(name, key, value)
        self._nodes.pose(part_poses(self.placed.scene))

    # Free fall.

    def _simulation(self) -> FreeFall:
        """Return the simulation of the shown scene, which is compiled on first use."""
        if self._fall is None:
            self._fall = FreeFall(self.placed.scene, self._show_frame)
        return self._fall

    def _discard_simulation(self) -> None:
        if self._fall is not None:
            self._fall.pause()
            self._fall = None
        self._play.label = "Play"

    def _toggle_play(self) -> None:
        fall = self._simulation()
        if fall.playing:
            fall.pause()
        else:
            fall.play()
        self._play.label = "Pause" if fall.playing else "Play"

    def _restart(self) -> None:
        fall = self._simulation()
        fall.reset()
        self._show_frame(fall)

    def _show_frame(self, fall: FreeFall) -> None:
        self._nodes.pose(fall.poses())
        self._status.content = message(f"{fall.seconds:.2f} s simulated")

    # Objects.

    def select(self, name: str) -> None:
        """Show the properties of an object; if the scene has no such object, select none."""
        names = {obj.name for obj in self.placed.scene.objects}
        self._selected = name if name in names else ""
        if self._selected:
            self._chooser.value = name
            self._facts.content = message(
                *object_facts(self._target, self.placed.scene.object(name))
            )
        self._show_handle()

    def _show_handle(self) -> None:
        """Show a handle that moves the selected object on its support and turns it."""
        if self.handle is not None:
            self.handle.remove()
            self.handle = None
        self._nodes.pickable(not self._drag.value)
        if not (self._drag.value and self._selected):
            return
        name = self._selected
        if self.placed.scene.object(name).environment:
            raise SpecError(f"{name} is part of the environment and cannot be moved")
        low, high = bounds_of(self.placed.scene)
        start = self.placed.handle_pose(name)
        self.handle = self._server.scene.add_transform_controls(
            "/handle",
            scale=0.35 * float(np.linalg.norm(high - low)),
            active_axes=(True, True, False),
            disable_sliders=False,
            depth_test=False,
            rotation_limits=((0.0, 0.0), (0.0, 0.0), (-1000.0, 1000.0)),
            position=start.pos,
            wxyz=start.quat,
        )
        self._on(self.handle, lambda event: self._dragged(name, event))

    def _dragged(self, name: str, event: Any) -> None:
        self._discard_simulation()
        self.placed.place(name, pose(event.target.position, event.target.wxyz))
        if event.phase == "end":
            self.placed.snap()
        self._nodes.pose(part_poses(self.placed.scene))

    def _save(self) -> None:
        assert self._target.run is not None
        write_layout_patch(self._target.run, self.placed.patch)
        self._status.content = message(
            f"Saved in {LAYOUT_PATCH}; neoworld reconstruct PHOTO --out {self._target.run} "
            "--resume composes and refines the scene with it."
        )


def joint_range(joint: JointSpec) -> tuple[float, float]:
    """Return the lower and upper end of a joint's slider [rad or m]."""
    if joint.type == "ball":
        limit = joint.upper or FREE_RANGE
        return -limit, limit
    if joint.type == "continuous":
        return -FREE_RANGE, FREE_RANGE
    return joint.lower, joint.upper


def settable_joints(obj: SceneObject) -> list[tuple[JointSpec, str]]:
    """Return the joints of an object that a person can set, with the keys of their values."""
    return [
        (joint, key)
        for joint in obj.spec.joints
        if joint.type != "fixed" and joint.mimic is None
        for key in joint_keys(joint)
    ]


def verdict_of(target: ViewTarget) -> list[str]:
    """Return the title, and the verdict on the scene of a run."""
    if target.run is None:
        return [target.title]
    return [target.title, verdict_line(read_run(target.run)["metrics"])]


def object_facts(target: ViewTarget, obj: SceneObject) -> list[str]:
    """Return lines with an object's label, support, size, mass, evidence and failed checks."""
    low, high = bounds(obj.spec, obj.joint_state)
    size = " x ".join(f"{100 * v:.1f}" for v in high - low)
    mass = sum(inertial(obj.spec, part).mass for part in obj.spec.parts)
    support = f"{obj.relation} {obj.parent}" if obj.parent else "in the world"
    lines = [
        f"{obj.name}: {obj.spec.label or 'no label'}",
        f"{support}{', fixed' if obj.static else ''}; {size} cm; {mass:.3g} kg",
    ]
    if target.run is None:
        return lines
    lines += _evidence(target.run, obj)
    verified = read_json(target.run / "objects" / obj.name / "verify.json")
    if verified is None:
        return lines
    failed = [f"not valid: {check.phrase()}" for check in object_checks(verified) if check.failed]
    return [*lines, *(failed or ["passes its object checks"])]


def _evidence(run: Path, obj: SceneObject) -> list[str]:
    """Return lines on the evidence of an object's pose, and on its standard deviations."""
    aligned = read_json(run / "compose" / "align.json") or {}
    boxes = (read_run(run)["metrics"].get("box_iou") or {}).get("objects", {})
    try:
        found = evidence_lines(aligned, boxes.get(obj.name, {}), obj.name, obj.parent or "world")
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        return [f"compose/align.json has an unexpected structure: {error}"]
    lines = [f"{kind}: {line}" for kind, line in found.items()]
    if obj.uncertainty is not None:
        lines.append(f"known to: {deviation_phrase(obj.uncertainty.model_dump())}")
    return lines

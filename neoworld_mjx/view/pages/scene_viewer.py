"""Page of `neoworld view`, which shows a scene, its photograph, free fall, search and objects."""

import logging
import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...compose.layout_patch import LayoutPatch, read_layout_patch
from ...config import Config
from ...errors import NeoWorldError
from ...io.files import write_atomic
from ...run_folder import Result
from ...spec import Box2D
from .annotation_drawing import draw_photo_box
from .joint_sliders import JointSliders
from .page_html import message
from .page_jobs import ShowLine, run_job
from .population import Ghosts, term_chart
from .rectangle_picker import RectanglePicker
from .scene_editor import SceneEditor
from .scene_nodes import (
    SceneNodes,
    add_handle,
    bounds_of,
    light_scene,
    look_at,
    look_through,
    part_poses,
)
from .view_target import ViewTarget, open_target

if TYPE_CHECKING:
    from ...program import BuildResult
    from .free_fall import FreeFall

_log = logging.getLogger(__name__)

SEARCH = "Search again from here"


class SceneViewer:
    """Viewer of one target on the page of a server."""

    def __init__(
        self,
        server: Any,
        path: Path,
        target: ViewTarget,
        config: Config,
        *,
        rebuild: Callable[[Path, str, str], "tuple[BuildResult, Result | None]"],
        search_again: Callable[[Path, LayoutPatch], Result],
    ):
        """Show a target.

        Args:
            server: the viser server.
            path: path of the target; the viewer reads it again after a change.
            target: the contents of `path`.
            config: options for programs, and for the search of a scene without a run.
            rebuild: function that builds an object's program in a run folder, and repeats the later
                steps.
            search_again: function that composes a run's scene with a layout patch, and refines the
                scene.
        """
        self._rebuild_object, self._search_again = rebuild, search_again
        self._server, self._path, self._config = server, path, config
        self._busy, self._drawing = threading.Lock(), threading.Lock()
        self._target = target
        self._nodes = SceneNodes(server, self.select)
        self._fall: "FreeFall | None" = None
        self._handle: Any = None
        self._chart: Any = None
        self._selected = ""
        self._rectangle = RectanglePicker(
            server, lambda: self._target.after.camera, self._set_photo_box
        )
        light_scene(server)
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Scene"):
            self._build_scene_tab()
        with tabs.add_tab("Objects"):
            self._build_object_tab()
        with tabs.add_tab("Search"):
            self._build_search_tab()
        self._load()
        server.on_client_connect(self._show_home_view)

    def _build_scene_tab(self) -> None:
        gui = self._server.gui
        self._home_button = gui.add_button("Photo's camera")
        self._home_button.on_click(lambda event: self._show_home_view(event.client))
        self._blend = gui.add_slider("Photo", 0.0, 1.0, 0.05, 0.0)
        self._blend.on_update(lambda _: self._show_photo())
        self._layout = gui.add_button_group("Layout", ("before", "after"))
        self._layout.on_click(lambda _: self._show(self._layout.value))
        self._colliders = gui.add_checkbox("Colliders", False)
        self._colliders.on_update(lambda _: self._show_colliders())
        self._contacts = gui.add_checkbox("Contacts", False)
        self._contacts.on_update(lambda _: self._toggle_contacts())
        with gui.add_folder("Free fall"):
            self._play = gui.add_button("Play")
            self._play.on_click(lambda _: self._toggle())
            gui.add_button("Restart").on_click(lambda _: self._restart())
            self._speed = gui.add_slider("Push, m/s", 0.1, 5.0, 0.1, 0.5)
            self._push_direction = gui.add_slider("Push direction, deg", -180, 180, 5, 0)
            gui.add_button("Push the selected object").on_click(lambda _: self._push())
        self._status = gui.add_html("")
        self._joints = JointSliders(self._server, gui.add_folder("Joints"), self._move_joint)

    def _build_object_tab(self) -> None:
        gui = self._server.gui
        names = [obj.name for obj in self._target.after.objects]
        self._chooser = gui.add_dropdown("Object", ("none", *names))
        self._chooser.on_update(lambda _: self.select(self._chooser.value))
        self._drag = gui.add_checkbox("Drag", False)
        self._drag.on_update(lambda _: self._toggle_drag())
        self._box = gui.add_button("Draw its box in the photograph")
        self._box.on_click(lambda event: self._begin_box(event.client))
        self._facts = gui.add_html(message("Click an object, or choose one."))
        self._crop = gui.add_image(np.zeros((1, 1, 3), np.uint8), label="In the photograph")
        self._crop.visible = False
        self._text = gui.add_text("Program", "", multiline=True, visible=False)
        self._build = gui.add_button("Rebuild", visible=False)
        self._build.on_click(lambda _: run_job(self._busy, self._signals, self._rebuild))
        self._signals = gui.add_html("")

    def _build_search_tab(self) -> None:
        gui = self._server.gui
        self._ghosts_on = gui.add_checkbox("Population as ghosts", False)
        self._iteration = gui.add_slider("Iteration", 1, 2, 1, 1)
        for control in (self._ghosts_on, self._iteration):
            control.on_update(lambda _: self._show_ghosts())
        gui.add_button(SEARCH).on_click(lambda _: self._search())
        discard = gui.add_button("Discard edits")
        discard.on_click(lambda _: run_job(self._busy, self._log, self._discard))
        self._log = gui.add_html("")
        self._ghosts = Ghosts(
            self._server, lambda line: setattr(self._log, "content", message(line))
        )
        self._charts = gui.add_folder("Rewards")

    def _load(self) -> None:
        """Show the current target."""
        target = self._target
        self._discard_simulation()
        patch = LayoutPatch() if target.run is None else read_layout_patch(target.run)
        self._editor = SceneEditor(target.after, patch)
        self._nodes.show(target.after)
        self._layout.visible = target.before is not None
        self._blend.visible = target.picture is not None and target.after.camera is not None
        self._home_button.visible = target.after.camera is not None
        self._box.visible = self._blend.visible
        self._ghosts.reset()
        self._layout.value = "after"
        self._joints.show(self._editor.scene)
        self._load_history()
        self._show_colliders()
        names = [obj.name for obj in target.after.objects]
        if self._selected in names:
            self.select(self._selected)
        elif len(names) == 1:
            self.select(names[0])

    def _load_history(self) -> None:
        history = self._target.history()
        if self._chart is not None:
            self._chart.remove()
            self._chart = None
        for control in (self._ghosts_on, self._iteration):
            control.visible = history is not None
        if history is not None:
            iterations = len(history["absolute"])
            self._iteration.max = max(iterations, 2)
            self._iteration.value = iterations
            self._iteration.disabled = iterations < 2
            with self._charts:
                self._chart = term_chart(self._server, history)
        self._charts.visible = history is not None

    def _show_home_view(self, client: Any) -> None:
        scene = self._nodes.scene
        if scene is None:
            return
        if scene.camera is not None:
            look_through(client, scene.camera)
        else:
            look_at(client, *bounds_of(scene, self._nodes.poses))

    def _show(self, layout: str) -> None:
        """Show the scene before or after the search."""
        target = self._target
        self._discard_simulation()
        shows_before = layout == "before" and target.before is not None
        self._editor.scene = target.before if shows_before and target.before else target.after
        self._nodes.show(self._editor.scene)
        self._joints.show(self._editor.scene)
        self._show_colliders()
        self._show_contacts()

    def _show_photo(self) -> None:
        camera, picture = self._target.after.camera, self._target.picture
        if camera is not None and picture is not None:
            self._nodes.blend(camera, picture, self._blend.value)
            self._show_photo_box()

    def _show_colliders(self) -> None:
        with self._drawing:  # The last of several clicks wins.
            self._nodes.show_visible(not self._colliders.value)
            if self._colliders.value:
                self._nodes.show_pieces()
            else:
                self._nodes.hide_pieces()

    def _toggle_contacts(self) -> None:
        self._nodes.set_transparent(self._contacts.value)
        self._show_contacts()

    def _show_contacts(self) -> None:
        if not self._contacts.value:
            self._nodes.hide_contacts()
            return
        fall = self._simulation()
        if fall is None:
            return
        contacts = fall.contacts()
        self._nodes.show_contacts(contacts.points, contacts.depths, contacts.normals)
        if not fall.playing:
            self._status.content = message(contacts.summary())

    def _move_joint(self, name: str, key: str, value: float) -> None:
        self._discard_simulation()
        self._editor.set_joint(name, key, value)
        self._nodes.pose(part_poses(self._editor.scene))

    def _simulation(self) -> "FreeFall | None":
        """Return the simulation of the shown scene, which is compiled on first use."""
        if self._fall is None:
            from .free_fall import FreeFall

            try:
                self._fall = FreeFall(self._editor.scene, self._show_frame)
            except (NeoWorldError, ValueError) as error:
                self._status.content = message(
                    f"MuJoCo cannot simulate the scene: {error}", bad=True
                )
        return self._fall

    def _discard_simulation(self) -> None:
        if self._fall is not None:
            self._fall.pause()
            self._fall = None
            self._play.label = "Play"

    def _toggle(self) -> None:
        fall = self._simulation()
        if fall is None:
            return
        if fall.playing:
            fall.pause()
            self._play.label = "Play"
        else:
            fall.play()
            self._play.label = "Pause"

    def _restart(self) -> None:
        fall = self._simulation()
        if fall is not None:
            fall.reset()
            self._show_frame(fall)

    def _show_frame(self, fall: "FreeFall") -> None:
        self._nodes.pose(fall.poses())
        self._status.content = message(f"{fall.seconds:.2f} s simulated")
        if self._contacts.value:
            self._show_contacts()

    def _push(self) -> None:
        fall = self._simulation()
        direction = math.radians(self._push_direction.value)
        velocity = self._speed.value * np.array([math.cos(direction), math.sin(direction), 0.0])
        if not self._selected:
            self._status.content = message("Select an object first: click it.")
        elif fall is not None and not fall.push(self._selected, velocity):
            self._status.content = message(f"{self._selected} is fixed.")

    def select(self, name: str) -> None:
        """Show the properties of an object."""
        from ...verify.patched import read_program
        from .object_facts import crop_of, facts

        if name not in {obj.name for obj in self._editor.scene.objects}:
            self._selected = ""
            return
        self._selected = name
        if self._chooser.value != name:
            self._chooser.value = name
        self._facts.content = facts(self._target, self._editor.scene.object(name))
        crop = crop_of(self._target, name)
        self._crop.visible = crop is not None
        if crop is not None:
            self._crop.image = crop
        program = self._target.program_of(name)
        self._text.visible = self._build.visible = program is not None
        self._text.value = "" if program is None else read_program(program)
        self._signals.content = ""
        self._show_photo_box()
        self._show_handle()

    def _toggle_drag(self) -> None:
        self._nodes.pickable(not self._drag.value)
        self._show_handle()

    def _show_handle(self) -> None:
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
        if not (self._drag.value and self._selected):
            return
        if self._editor.scene.object(self._selected).environment:
            self._facts.content = message(
                f"{self._selected} is part of the environment and cannot be moved."
            )
            return
        handle, name = self._editor.handle_pose(self._selected), self._selected
        low, high = bounds_of(self._editor.scene, self._nodes.poses)
        self._handle = add_handle(self._server, handle, float(np.linalg.norm(high - low)))
        self._handle.on_update(lambda event: self._dragged(name, event))

    def _dragged(self, name: str, event: Any) -> None:
        self._discard_simulation()
        self._editor.place(name, event.target.position, event.target.wxyz)
        if event.phase == "end":
            self._editor.snap()
        self._nodes.pose(part_poses(self._editor.scene))

    def _begin_box(self, client: Any) -> None:
        if not self._selected:
            self._facts.content = message("Select an object first: click it, or choose it.")
            return
        self._blend.value = max(self._blend.value, 0.6)
        self._show_photo()
        self._signals.content = message(
            f"Drag a rectangle around the visible part of {self._selected}."
        )
        self._rectangle.begin(client)

    def _set_photo_box(self, box: Box2D | None) -> None:
        if box is None or not self._selected:
            self._signals.content = message("The box is too small: draw it again.", bad=True)
            return
        self._editor.set_box(self._selected, box)
        self._show_photo_box()
        self._signals.content = message(f"The search uses this box: press {SEARCH} on its tab.")

    def _show_photo_box(self) -> None:
        """Show the box of the selected object if the photograph is visible."""
        visible = self._blend.visible and self._blend.value > 0
        draw_photo_box(self._server, self._editor.scene, self._selected if visible else "")

    def _rebuild(self, show_line: ShowLine) -> None:
        from ...program import build
        from .object_facts import signals_of

        name, text = self._selected, self._text.value
        program = self._target.program_of(name)
        if program is None:
            return
        show_line("building ...")
        if self._target.run is not None:
            built, result = self._rebuild_object(self._target.run, name, text)
            self._reload(result)
        else:
            built = build(text, self._config.program)
            if built.spec is not None:
                write_atomic(program, text)
            if built.spec is not None and self._target.program is not None:
                self._target = open_target(self._path, self._config)
                self._load()
        self._text.value = text
        self._signals.content = signals_of(built)

    def _show_ghosts(self) -> None:
        iteration = round(self._iteration.value) if self._ghosts_on.value else 0
        scene = self._target.before or self._target.after
        self._ghosts.show(scene, self._target.history(), iteration)

    def _search(self) -> None:
        self._discard_simulation()
        run_job(self._busy, self._log, self._run_search)

    def _run_search(self, show_line: ShowLine) -> None:
        from ...refinement import refine

        show_line("searching ...")
        if self._target.run is not None:
            self._reload(self._search_again(self._target.run, self._editor.patch))
            return
        self._editor.snap()
        options, seed = self._config.refine, self._config.seed
        refined = refine(self._editor.scene, options, seed=seed, progress=_log.info)
        outcome = "valid" if refined.passed else "not valid"
        if self._target.scene_file is not None:
            write_atomic(self._target.scene_file, refined.scene.to_json())
            outcome += f"; {self._target.scene_file.name} contains the new scene"
            self._target = open_target(self._path, self._config)
            self._load()
        self._log.content = message(outcome, bad=not refined.passed)

    def _discard(self, show_line: ShowLine) -> None:
        old, self._editor.patch = self._editor.patch, LayoutPatch()
        if self._target.run is not None and old.objects:
            self._reload(self._search_again(self._target.run, LayoutPatch()))
        else:
            self._load()

    def _reload(self, result: Result | None) -> None:
        if result is not None:
            self._target = open_target(self._path, self._config)
            self._load()
            self._log.content = message(repr(result), bad=result.passed is False)

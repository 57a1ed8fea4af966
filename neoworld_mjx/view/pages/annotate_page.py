"""Page of `neoworld annotate`, on which a person marks boxes, labels and camera of a photograph."""

import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ...annotation.annotation import (
    EXISTING_PROGRAM,
    GROUND,
    SHAPES,
    WRITTEN_BY_MODEL,
    AnnotatedObject,
    Annotation,
)
from ...annotation.edits import find_object, with_box, with_change, without
from ...config import Config
from ...errors import SpecError
from ...fit.vanishing_points import camera_of_lines
from ...io.names import is_name
from ...parse.photo import load_photo
from ...program.materials import MATERIALS
from ...run_folder import Result
from ...spec import Box2D, Camera, PartState, read_scene
from ...templates import templates
from .annotation_drawing import draw_boxes, draw_grid, draw_photo
from .line_picker import LinePicker
from .page_html import message
from .page_jobs import ShowLine, run_job
from .rectangle_picker import RectanglePicker
from .scene_nodes import SceneNodes, look_through
from .view_target import shown_picture

FOVY_DEG, PITCH_DEG, HEIGHT_M = 45.0, 35.0, 0.6
"""Initial camera of an annotation without objects."""
JOINT_TYPES = ("revolute", "prismatic", "continuous")
GROUNDS = ("table top", "floor", "counter", "ground")
NEW = "new object"
CORNERS = ("Box left", "Box top", "Box right", "Box bottom")
SIZES = ("Known depth, m", "Known width, m", "Known height, m")


def empty_annotation(photo: Path, config: Config) -> Annotation:
    """Return an annotation without objects for a photograph."""
    width, height = load_photo(photo, config.parse.max_side_px).original_size
    return Annotation(
        camera=Camera(
            width=width,
            height_px=height,
            fovy=math.radians(FOVY_DEG),
            height=HEIGHT_M,
            pitch=math.radians(PITCH_DEG),
        )
    )


class Annotator:
    """Editor of an annotation on the page of a server.

    The annotation is the only state. Editing a field changes one value of the annotation, and a
    lock serializes the edits. The page writes the fields only when another object is selected,
    because viser calls back from several threads, and an old value must never overwrite a person's
    input.
    """

    def __init__(
        self,
        server: Any,
        photo: Path,
        out: Path,
        annotation: Annotation,
        config: Config,
        write: Callable[[Annotation, bool], Result],
    ):
        """Show a photograph with its annotation.

        Args:
            server: the viser server.
            photo: the image file.
            out: the run folder to write.
            annotation: the initial annotation.
            config: options of the run.
            write: function that writes an annotation into the run folder; if its second argument
                is True, it also simulates the scene.
        """
        self._write_annotated = write
        self._server, self._photo, self._out, self._config = server, photo, out, config
        self.annotation = annotation
        self._picture = shown_picture(load_photo(photo, config.parse.max_side_px).rgb)
        self._nodes = SceneNodes(server, lambda _: None)
        self._selected = ""
        self._rectangle = RectanglePicker(server, lambda: self.annotation.camera, self._set_box)
        self._editing, self._busy = threading.Lock(), threading.Lock()
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map(None)
        server.scene.add_light_hemisphere("/light/sky", intensity=1.2)
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Camera"):
            self._build_camera_tab()
        with tabs.add_tab("Objects"):
            self._build_object_tab()
        with tabs.add_tab("Scene"):
            self._build_scene_tab()
        self._choose("")
        self._draw_camera()
        server.on_client_connect(lambda client: look_through(client, self.annotation.camera))

    # Tabs.

    def _build_camera_tab(self) -> None:
        gui, camera = self._server.gui, self.annotation.camera
        gui.add_html(
            message(
                "Adjust the camera until the grid lies on the ground, or mark lines on the ground."
            )
        )
        self._lines_message = gui.add_html("")
        self._picker = LinePicker(self._server, self._show_lines_message, self._take_lines)
        lines = gui.add_button("Mark lines on the ground")
        lines.on_click(lambda event: self._begin_lines(event.client))
        pitch, roll = math.degrees(camera.pitch), math.degrees(camera.roll)
        lens = {
            "pitch": gui.add_slider("Pitch, deg", -90, 90, 0.5, pitch),
            "height": gui.add_number("Height, m", camera.height, min=0.01, max=50.0, step=0.001),
            "fovy": gui.add_slider("Field of view, deg", 1, 179, 0.5, math.degrees(camera.fovy)),
            "roll": gui.add_slider("Roll, deg", -180, 180, 0.5, math.remainder(roll, 360)),
        }
        self._lens = lens
        for field, control in lens.items():
            self._on_edit(control, lambda value, field=field: self._set_camera(field, value))
        ground = gui.add_dropdown("Ground", GROUNDS, initial_value=self.annotation.ground)
        self._on_edit(ground, self._set_ground)
        self._grid_step = gui.add_number("Grid, m", 0.1, min=0.01, max=5.0, step=0.01)
        self._on_edit(self._grid_step, lambda _: self._draw_camera())

    def _build_object_tab(self) -> None:
        gui = self._server.gui
        self._chooser = gui.add_dropdown("Object", (NEW,))
        self._on_edit(self._chooser, self._choose)
        gui.add_button("Draw its box").on_click(lambda event: self._begin_box(event.client))
        self._message = gui.add_html("")
        self._object_folder = gui.add_folder("This object")
        kinds = (*SHAPES, WRITTEN_BY_MODEL, EXISTING_PROGRAM, *templates())
        with self._object_folder:
            self._fields = {
                "name": gui.add_text("Name", ""),
                "label": gui.add_text("Label", ""),
                "kind": gui.add_dropdown("Kind", kinds),
                "material": gui.add_dropdown("Material", tuple(MATERIALS)),
                "parent": gui.add_dropdown("Support", (GROUND,)),
                "relation": gui.add_dropdown("Relation", ("on", "in", "attached", "leaning")),
                "support": gui.add_checkbox("Environment", False),
                "fixed_base": gui.add_checkbox("Fixed", False),
                "yaw_deg": gui.add_slider("Heading, deg", -180, 180, 1, 180.0),
            }
            self._sizes = [gui.add_number(s, 0.0, min=0.0, max=50.0, step=0.001) for s in SIZES]
            self._corners = [gui.add_number(label, 0.0, step=0.1) for label in CORNERS]
            with gui.add_folder("Moving part"):
                self._part = gui.add_text("Part", "")
                self._motion = gui.add_dropdown("Joint", JOINT_TYPES)
                self._opening = gui.add_slider("Open", 0.0, 1.0, 0.05, 0.0)
                self._on_edit(gui.add_button("Set the part"), lambda _: self._set_part())
            self._on_edit(gui.add_button("Delete"), lambda _: self._delete())
        for field, control in self._fields.items():
            self._on_edit(control, lambda value, field=field: self._set_field(field, value))
        for k, control in enumerate(self._sizes):
            self._on_edit(control, lambda value, k=k: self._set_size(k, value))
        for k, control in enumerate(self._corners):
            self._on_edit(control, lambda value, k=k: self._set_corner(k, value))

    def _build_scene_tab(self) -> None:
        gui = self._server.gui
        gui.add_button("Save").on_click(lambda _: self._write(simulate=False))
        gui.add_button("Build the scene").on_click(lambda _: self._write(simulate=True))
        self._log = gui.add_html(message(f"The run folder is {self._out}."))

    def _on_edit(self, control: Any, edit: Callable[[Any], None]) -> None:
        """Call `edit` with the new value when a person, but not the page, changes a control."""

        def edited(event: Any) -> None:
            if event.client_id is None:
                return
            with self._editing:
                try:
                    edit(_clipped(event.target))
                except SpecError as error:
                    self._message.content = message(str(error), bad=True)

        control.on_update(edited) if hasattr(control, "on_update") else control.on_click(edited)

    # Edits.

    def _set_camera(self, field: str, value: float) -> None:
        number = float(value) if field == "height" else math.radians(value)
        camera = self.annotation.camera.model_copy(update={field: number})
        self.annotation = self.annotation.model_copy(update={"camera": camera})
        self._draw_camera()
        for client in self._server.get_clients().values():
            look_through(client, camera)

    def _show_lines_message(self, line: str, *, bad: bool = False) -> None:
        self._lines_message.content = message(line, bad=bad)

    def _begin_lines(self, client: Any) -> None:
        """Use the next clicks on the photograph as end points of lines on the ground."""
        with self._editing:
            look_through(client, self.annotation.camera)
            self._picker.begin(self.annotation.camera)

    def _take_lines(self, along: NDArray, across: NDArray) -> None:
        """Set the camera that puts the marked lines on the ground."""
        with self._editing:
            try:
                camera, has_fovy = camera_of_lines(self.annotation.camera, along, across)
            except SpecError as error:
                self._show_lines_message(str(error), bad=True)
                return
            for field in ("pitch", "roll", "fovy"):
                degrees = math.degrees(getattr(camera, field))
                self._lens[field].value = round(degrees, 1)
            self.annotation = self.annotation.model_copy(update={"camera": camera})
            self._draw_camera()
        lens = "including the field of view" if has_fovy else "except the field of view"
        self._show_lines_message(
            f"The lines determine the camera, {lens}; set the height yourself."
        )
        for client in self._server.get_clients().values():
            look_through(client, camera)

    def _set_ground(self, label: str) -> None:
        self.annotation = self.annotation.model_copy(update={"ground": label})

    def _begin_box(self, client: Any) -> None:
        """Use the next rectangle on the photograph as the object's box."""
        with self._editing:
            self._message.content = message(
                "Drag a rectangle around the visible part of the object."
            )
            self._rectangle.begin(client)

    def _set_box(self, box: Box2D | None) -> None:
        with self._editing:
            self._take_box(box)

    def _take_box(self, box: Box2D | None) -> None:
        if box is None:
            self._message.content = message("The box is too small: draw it again.", bad=True)
            return
        if self._selected:
            self._change({"box": box})
            self._choose(self._selected)
        else:
            self.annotation, name = with_box(self.annotation, box)
            self._choose(name)

    def _set_field(self, field: str, value: Any) -> None:
        if field == "name" and not is_name(value):
            raise SpecError("a name consists of letters, digits and _, and starts with a letter")
        renamed = field == "name" and value != self._selected
        self._change({field: value[:100] if field == "label" else value})
        if renamed:
            self._selected = value
            self._list_objects()
        self._draw_boxes()

    def _set_size(self, k: int, value: float) -> None:
        known = self._object().size or [float(control.value) for control in self._sizes]
        size = (*known[:k], float(value), *known[k + 1 :])
        self._change({"size": size if min(size) > 0 else None})
        self._draw_boxes()

    def _set_corner(self, k: int, value: float) -> None:
        corners = self._object().box.as_tuple()
        x0, y0, x1, y1 = (*corners[:k], float(value), *corners[k + 1 :])
        if not (x0 < x1 and y0 < y1):
            raise SpecError("left must be less than right, and top less than bottom")
        self._change({"box": Box2D(x0=x0, y0=y0, x1=x1, y1=y1)})
        self._draw_boxes()

    def _set_part(self) -> None:
        if not is_name(self._part.value):
            raise SpecError(
                "the part needs a name of letters, digits and _ that starts with a letter"
            )
        part, motion, opening = self._part.value, self._motion.value, self._opening.value
        state = PartState(part=part, type=motion, opening=opening)
        parts = (*(p for p in self._object().parts if p.part != part), state)
        self._change({"parts": parts})
        listed = ", ".join(f"{p.part} {p.type} {p.opening:.0%}" for p in parts)
        self._message.content = message(f"Parts: {listed}")

    def _delete(self) -> None:
        self.annotation = without(self.annotation, self._selected)
        self._choose("")

    def _object(self) -> AnnotatedObject:
        obj = find_object(self.annotation, self._selected)
        if obj is None:
            raise SpecError("choose an object, or draw the box of a new one")
        return obj

    def _change(self, change: dict[str, Any]) -> None:
        self.annotation = with_change(self.annotation, self._object().name, change)

    # Display.

    def _choose(self, name: str) -> None:
        """Select an object and show its fields; hide them for a new object."""
        obj = find_object(self.annotation, name)
        self._selected = "" if obj is None else obj.name
        self._list_objects()
        self._object_folder.visible = obj is not None
        if obj is not None:
            for field, control in self._fields.items():
                control.value = getattr(obj, field)
            for control, value in zip(self._sizes, obj.size or (0, 0, 0), strict=True):
                control.value = value
            for control, value in zip(self._corners, obj.box.as_tuple(), strict=True):
                control.value = value
        self._draw_boxes()

    def _list_objects(self) -> None:
        names = [obj.name for obj in self.annotation.objects]
        parent = self._fields["parent"]
        _set_options(self._chooser, (NEW, *names), self._selected or NEW)
        obj = find_object(self.annotation, self._selected)
        others = (GROUND, *(name for name in names if name != self._selected))
        _set_options(parent, others, GROUND if obj is None else obj.parent)

    def _draw_camera(self) -> None:
        camera = self.annotation.camera
        with self._server.atomic():
            draw_photo(self._server, camera, self._picture)
            draw_grid(self._server, camera, _clipped(self._grid_step))
        self._draw_boxes()

    def _draw_boxes(self) -> None:
        self._nodes.show_visible(False)  # The built scene would cover the photograph.
        try:
            size = draw_boxes(self._server, self.annotation, self._selected)
        except SpecError as error:
            self._message.content = message(str(error), bad=True)
        else:
            self._message.content = message(size) if size else ""

    # Run.

    def _write(self, *, simulate: bool) -> None:
        def job(show_line: ShowLine) -> None:
            show_line("running ...")
            with self._editing:
                annotation = self.annotation
            self._show(self._write_annotated(annotation, simulate))

        run_job(self._busy, self._log, job)

    def _show(self, result: Result) -> None:
        scene = self._out / "scene.json"
        if result.until is None and scene.is_file():
            self._nodes.show(read_scene(scene))
            self._nodes.show_visible(True)
            verdict = "the scene is stable" if result.passed else "the scene fails its checks"
            self._log.content = message(f"Done: {verdict}. {result!r}", bad=not result.passed)
        else:
            self._log.content = message(
                f"Saved in {self._out}; continue with neoworld reconstruct --resume"
            )


def _clipped(control: Any) -> Any:
    """Return the value of a control, clipped to its bounds.

    While a person types 0.05, the value is at first 0, which may lie below the minimum.
    """
    low, high = getattr(control, "min", None), getattr(control, "max", None)
    if low is None or high is None:
        return control.value
    return min(max(control.value, low), high)


def _set_options(chooser: Any, options: tuple[str, ...], value: str) -> None:
    """Set the value of a dropdown, and also its options if they have changed."""
    if chooser.options != options:
        chooser.options = options
    chooser.value = value

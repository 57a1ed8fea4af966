"""Page of `neoworld annotate`, on which a person marks boxes, labels and camera of a photograph."""

import logging
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SpecError
from ..evidence.known_camera import KnownCamera
from ..io.names import is_name
from ..parse.photo import Photo
from ..program.supports import MATERIALS
from ..render.tiles import RGB
from ..run_folder import Result
from ..spec import Box2D, Camera, PartState, read_scene
from ..templates import templates
from .annotated_tree import annotated_tree
from .annotation import (
    EXISTING_PROGRAM,
    GROUND,
    SHAPES,
    WRITTEN_BY_MODEL,
    AnnotatedObject,
    Annotation,
)
from .scene_nodes import NEAR_M, SceneNodes, add_picture, look_through
from .server import failure, message
from .target import shown_picture

FOVY_DEG, PITCH_DEG, HEIGHT_M = 45.0, 35.0, 0.6
"""Initial camera of an annotation without objects."""
JOINT_TYPES = ("revolute", "prismatic", "continuous")
GROUNDS = ("table top", "floor", "counter", "ground")
NEW = "new object"
SIZES = ("Known depth, m", "Known width, m", "Known height, m")
FAR, FARTHEST_M = 40.0, 800.0
"""Distance of the photograph from the camera, as a multiple of the camera's height, and its upper
limit [m]."""
GRID_M = 0.1
"""Distance between the lines of the grid on the ground [m]."""
MIN_EDGE_PX = 2.0
"""Minimum edge length of a box [px]."""
CHOSEN, OTHER, SOLID, GRID = (255, 210, 60), (90, 170, 255), (120, 230, 140), (255, 255, 255)
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]


def empty_annotation(photo: Photo, known: KnownCamera | None = None) -> Annotation:
    """Return an annotation without objects for a photograph, with what is known of its camera."""
    width, height = photo.original_size
    camera = Camera(
        width=width,
        height_px=height,
        fovy=math.radians(FOVY_DEG),
        height=HEIGHT_M,
        pitch=math.radians(PITCH_DEG),
    )
    return Annotation(camera=camera if known is None else known.camera(camera))


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
        photo: Photo,
        out: Path,
        annotation: Annotation,
        write: Callable[[Annotation, bool], Result],
    ):
        """Show a photograph with its annotation.

        Args:
            server: the viser server.
            photo: the photograph.
            out: the run folder to write.
            annotation: the initial annotation.
            write: function that writes an annotation into the run folder; if its second argument
                is True, it also simulates the scene.
        """
        self._write_annotated = write
        self._server, self._out = server, out
        self.annotation = annotation
        self._picture = shown_picture(photo.rgb)
        self._nodes = SceneNodes(server, lambda _: None)
        self._selected = ""
        self._draws_box = False
        self._editing, self._busy = threading.Lock(), threading.Lock()
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
            message("Adjust the camera until the grid, with lines every 10 cm, lies on the ground.")
        )
        pitch, roll = math.degrees(camera.pitch), math.degrees(camera.roll)
        self._lens = {
            "pitch": gui.add_slider("Pitch, deg", -90, 90, 0.5, pitch),
            "height": gui.add_number("Height, m", camera.height, min=0.01, max=50.0, step=0.001),
            "fovy": gui.add_slider("Field of view, deg", 1, 179, 0.5, math.degrees(camera.fovy)),
            "roll": gui.add_slider("Roll, deg", -180, 180, 0.5, math.remainder(roll, 360)),
        }
        for field, control in self._lens.items():
            self._on_edit(control, lambda value, field=field: self._set_camera(field, value))
        ground = gui.add_dropdown("Ground", GROUNDS, initial_value=self.annotation.ground)
        self._on_edit(ground, self._set_ground)

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
            with self._edit():
                edit(_clipped(event.target))

        control.on_update(edited) if hasattr(control, "on_update") else control.on_click(edited)

    # Edits.

    @contextmanager
    def _edit(self) -> Iterator[None]:
        """Serialize the edits, and show their errors on the page."""
        with self._editing:
            try:
                yield
            except Exception as error:  # Nobody reads a traceback.
                self._message.content = failure(error)

    def _set_camera(self, field: str, value: float) -> None:
        number = float(value) if field == "height" else math.radians(value)
        self.annotation = self.annotation.with_camera({field: number})
        self._draw_camera()
        for client in self._server.get_clients().values():
            look_through(client, self.annotation.camera)

    def _set_ground(self, label: str) -> None:
        self.annotation = self.annotation.with_fields(ground=label)

    def _begin_box(self, client: Any) -> None:
        """Use the next rectangle that a client draws on the photograph as the object's box."""
        with self._edit():
            look_through(client, self.annotation.camera)
            self._message.content = message(
                "Drag a rectangle around the visible part of the object."
            )
            if self._draws_box:
                return
            self._draws_box = True

        @self._server.scene.on_rect_select()
        def drawn(event: Any) -> None:
            self._server.scene.remove_rect_select_callback(drawn)
            with self._edit():
                self._draws_box = False
                view, camera = event.client.camera, self.annotation.camera
                corners = (event.screen_min, event.screen_max)
                self.set_box(*(pixel_of(view, camera, corner) for corner in corners))

    def set_box(self, low: NDArray, high: NDArray) -> None:
        """Set the box of the selected object, or of a new one.

        Args:
            low: upper left corner in the photograph [px].
            high: lower right corner.
        """
        if (high - low < MIN_EDGE_PX).any():
            self._message.content = message("The box is too small: draw it again.", bad=True)
            return
        x0, y0, x1, y1 = (round(float(v), 1) for v in (*low, *high))
        box = Box2D(x0=x0, y0=y0, x1=x1, y1=y1)
        if self._selected:
            self._change({"box": box})
            self._choose(self._selected)
        else:
            self.annotation, name = self.annotation.with_box(box)
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
        self.annotation = self.annotation.without(self._selected)
        self._choose("")

    def _object(self) -> AnnotatedObject:
        obj = self.annotation.find(self._selected)
        if obj is None:
            raise SpecError("choose an object, or draw the box of a new one")
        return obj

    def _change(self, change: dict[str, Any]) -> None:
        self.annotation = self.annotation.with_change(self._object().name, change)

    # Display.

    def _choose(self, name: str) -> None:
        """Select an object and show its fields; hide them for a new object."""
        obj = self.annotation.find(name)
        self._selected = "" if obj is None else obj.name
        self._list_objects()
        self._object_folder.visible = obj is not None
        if obj is not None:
            for field, control in self._fields.items():
                control.value = getattr(obj, field)
            for control, value in zip(self._sizes, obj.size or (0, 0, 0), strict=True):
                control.value = value
        self._draw_boxes()

    def _list_objects(self) -> None:
        names = [obj.name for obj in self.annotation.objects]
        _set_options(self._chooser, (NEW, *names), self._selected or NEW)
        obj = self.annotation.find(self._selected)
        others = (GROUND, *(name for name in names if name != self._selected))
        _set_options(self._fields["parent"], others, GROUND if obj is None else obj.parent)

    def _draw_camera(self) -> None:
        camera = self.annotation.camera
        distance = min(FAR * max(camera.height, 0.05), FARTHEST_M)
        reach = min(40 * GRID_M, distance / 2)
        ticks = np.arange(-reach, reach + GRID_M / 2, GRID_M)
        lines = [[[0.0, y, 0.0], [2 * reach, y, 0.0]] for y in ticks]
        lines += [[[x + reach, -reach, 0.0], [x + reach, reach, 0.0]] for x in ticks]
        with self._server.atomic():
            add_picture(self._server, camera, self._picture, distance)
            self._draw_lines("/grid", np.array(lines), GRID, 1)
        self._draw_boxes()

    def _draw_boxes(self) -> None:
        """Draw the 2D boxes in the picture, and the resulting 3D boxes in the world."""
        self._server.scene.remove_by_name("/scene")  # The scene would cover the photograph.
        with self._server.atomic():
            self._server.scene.remove_by_name("/boxes")
            for obj in self.annotation.objects:
                color = CHOSEN if obj.name == self._selected else OTHER
                lines = _outline(self.annotation.camera, obj.box)
                self._draw_lines(f"/boxes/{obj.name}", lines, color, 3)
            self._message.content = ""
            if not self.annotation.objects:
                return
            try:
                tree = annotated_tree(self.annotation)
            except SpecError as error:
                self._message.content = message(str(error), bad=True)
                return
            for obj in self.annotation.objects:
                corners = tree.node(obj.name).box3d.corners()
                lines = np.array([[corners[a], corners[b]] for a, b in _EDGES])
                self._draw_lines(f"/boxes/{obj.name}/solid", lines, SOLID, 2)
        if self._selected:
            size = " x ".join(f"{100 * v:.1f}" for v in tree.node(self._selected).box3d.size)
            text = f"{self._selected}: {size} cm (depth, width, height)"
            self._message.content = message(text)

    def _draw_lines(self, name: str, lines: NDArray, rgb: RGB, thickness: float) -> None:
        self._server.scene.add_line_segments(
            name, lines, rgb, thickness=thickness, thickness_units="screen"
        )

    # Run.

    def _write(self, *, simulate: bool) -> None:
        """Write the run, and show its last log line meanwhile, unless a run is being written."""
        if not self._busy.acquire(blocking=False):
            return
        self._log.content = message("running ...")
        log, package = _PageLog(self._log), logging.getLogger("neoworld_mjx")
        package.addHandler(log)
        try:
            with self._editing:
                annotation = self.annotation
            self._show(self._write_annotated(annotation, simulate))
        except Exception as error:  # The page must not show "running" for ever.
            self._log.content = failure(error)
        finally:
            package.removeHandler(log)
            self._busy.release()

    def _show(self, result: Result) -> None:
        scene = self._out / "scene.json"
        if result.until is None and scene.is_file():
            self._nodes.show(read_scene(scene))
            self._log.content = message(result.verdict, bad=not result.passed)
        else:
            self._log.content = message(
                f"Saved in {self._out}; continue with neoworld reconstruct --resume"
            )


class _PageLog(logging.Handler):
    """Log handler that shows the last line of the package's log in a text element."""

    def __init__(self, element: Any):
        super().__init__(logging.INFO)
        self._element = element

    def emit(self, record: logging.LogRecord) -> None:
        self._element.content = message(record.getMessage())


def pixel_of(view: Any, camera: Camera, position: tuple[float, float]) -> NDArray:
    """Return the pixel [2] of the photograph at a position in a client's window.

    The client must look through the photograph's camera.

    Args:
        view: camera of the client.
        camera: camera of the photograph.
        position: horizontal and vertical position in the window, 0 to 1.
    """
    window = np.array([view.image_width, view.image_height])
    focal = view.image_height / 2 / math.tan(view.fov / 2)
    offset = (np.array(position) - 0.5) * window * camera.focal / focal
    size = np.array([camera.width, camera.height_px])
    return np.clip(camera.center + offset, 0.0, size)


def _outline(camera: Camera, box: Box2D) -> NDArray:
    """Return the edges of a 2D box as lines in front of the photograph's camera [m], [4, 2, 3]."""
    x0, y0, x1, y1 = box.as_tuple()
    rays = camera.rays(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]))
    depth = rays @ camera.axes()[:, 2]
    points = camera.position() + rays * (NEAR_M / depth)[:, None]
    return np.stack([points[:-1], points[1:]], axis=1)


def _clipped(control: Any) -> Any:
    """Return the value of a control, clipped to its bounds.

    While a person types 0.05, the value is at first 0, which may lie below the minimum.
    """
    low, high = getattr(control, "min", None), getattr(control, "max", None)
    if low is None or high is None:
        return control.value
    if not math.isfinite(control.value):
        raise SpecError("enter a number")
    return min(max(control.value, low), high)


def _set_options(chooser: Any, options: tuple[str, ...], value: str) -> None:
    """Set the value of a dropdown, and also its options if they have changed."""
    if chooser.options != options:
        chooser.options = options
    chooser.value = value

"""Selection of four lines on a photograph by clicks, from which `annotate` derives the camera."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...spec import Camera
from .annotation_drawing import draw_marks, pixel_of

ENDS = 8
"""Number of end points."""
ORDER = (
    "two lines that recede from you and are parallel on the floor or table",
    "two lines perpendicular to them",
)


class LinePicker:
    """Collects clicks on the ends of two parallel lines, then of two lines perpendicular to them.

    Args:
        server: the viser server.
        show_line: function that shows the next instruction.
        done: function that receives the end points of both pairs of lines [px], each of shape
            [2, 2, 2].
    """

    def __init__(
        self,
        server: Any,
        show_line: Callable[[str], None],
        done: Callable[[NDArray, NDArray], None],
    ) -> None:
        self._server, self._show_line, self._done = server, show_line, done
        self._ends: list[NDArray] = []
        self._click: Callable[[Any], None] | None = None

    def begin(self, camera: Camera) -> None:
        """Use the next eight clicks as end points; discard earlier clicks."""
        self.end()
        self._show_prompt()

        @self._server.scene.on_click()
        def clicked(event: Any) -> None:
            self._add(camera, pixel_of(event.client.camera, camera, event.screen_pos))

        self._click = clicked

    def end(self) -> None:
        """Stop taking clicks, and remove the marks."""
        if self._click is not None:
            self._server.scene.remove_click_callback(self._click)
            self._click = None
        self._ends = []
        self._server.scene.remove_by_name("/marks")

    def _add(self, camera: Camera, pixel: NDArray) -> None:
        if self._click is None:
            return
        self._ends.append(pixel)
        if len(self._ends) < ENDS:
            draw_marks(self._server, camera, self._ends)
            self._show_prompt()
            return
        along, across = np.array(self._ends).reshape(2, 2, 2, 2)
        self.end()
        self._done(along, across)

    def _show_prompt(self) -> None:
        count = len(self._ends)
        self._show_line(f"Click both ends of {ORDER[count // 4]}: {count} of {ENDS} points.")

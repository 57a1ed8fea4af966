"""Clicks on a photograph that give the ends of four lines, for the camera of `annotate`."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...spec import Camera
from .annotation_drawing import draw_marks, pixel_of

ENDS = 8
ORDER = (
    "two lines that run away from you and are parallel on the floor or table",
    "two lines across them, at right angles",
)


class LinePicker:
    """Collects the ends of two lines, then of two across them, by clicks on the photograph.

    Args:
        server: of viser.
        tell: shows what is to be clicked next.
        done: called with the ends of both pairs, each [2, 2, 2] pixels.
    """

    def __init__(
        self,
        server: Any,
        tell: Callable[[str], None],
        done: Callable[[NDArray, NDArray], None],
    ) -> None:
        self._server, self._tell, self._done = server, tell, done
        self._ends: list[NDArray] = []
        self._click: Callable[[Any], None] | None = None

    def begin(self, camera: Camera) -> None:
        """Let the next eight clicks be ends of lines; earlier ones count no more."""
        self.end()
        self._say()

        @self._server.scene.on_click()
        def clicked(event: Any) -> None:
            self._add(camera, pixel_of(event.client.camera, camera, event.screen_pos))

        self._click = clicked

    def end(self) -> None:
        """Take no more clicks, and take the marks away."""
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
            self._say()
            return
        along, across = np.array(self._ends).reshape(2, 2, 2, 2)
        self.end()
        self._done(along, across)

    def _say(self) -> None:
        count = len(self._ends)
        self._tell(f"Click both ends of {ORDER[count // 4]}: {count} of {ENDS} points.")

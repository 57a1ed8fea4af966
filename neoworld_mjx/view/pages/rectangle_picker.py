"""Selection of a rectangle on the page, which gives a box in pixels of the photograph."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ...spec import Box2D, Camera
from .annotation_drawing import pixel_of
from .scene_nodes import look_through

MIN_EDGE_PX = 2.0
"""Minimum edge length of a box [px]."""


class RectanglePicker:
    """Tool with which a client draws one rectangle at a time."""

    def __init__(
        self,
        server: Any,
        camera: Callable[[], Camera | None],
        picked: Callable[[Box2D | None], None],
    ):
        """Create an inactive picker.

        Args:
            server: the viser server.
            camera: function that returns the photograph's camera; if it returns None, `begin` does
                nothing.
            picked: function that receives the box, or None if the box is too small.
        """
        self._server, self._camera, self._picked = server, camera, picked
        self._waiting = False

    def begin(self, client: Any) -> None:
        """Move a client's view to the photograph's camera, and take the next rectangle."""
        camera = self._camera()
        if camera is None:
            return
        look_through(client, camera)
        if self._waiting:
            return
        self._waiting = True

        @self._server.scene.on_rect_select()
        def on_rectangle(event: Any) -> None:
            self._server.scene.remove_rect_select_callback(on_rectangle)
            self._waiting = False
            view, current = event.client.camera, self._camera() or camera
            corners = (event.screen_min, event.screen_max)
            low, high = (pixel_of(view, current, corner) for corner in corners)
            if (np.asarray(high) - low < MIN_EDGE_PX).any():
                self._picked(None)
                return
            x0, y0, x1, y1 = (round(float(v), 1) for v in (*low, *high))
            self._picked(Box2D(x0=x0, y0=y0, x1=x1, y1=y1))

"""A rectangle that is dragged on the page, as a box in pixels of the photograph."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ...spec import Box2D, Camera
from .annotation_drawing import pixel_of
from .scene_nodes import look_through

LEAST_PX = 2.0
"""Shortest edge of a box."""


class RectanglePicker:
    """Waits for one rectangle at a time."""

    def __init__(
        self,
        server: Any,
        camera: Callable[[], Camera | None],
        picked: Callable[[Box2D | None], None],
    ):
        """Wait for nothing yet.

        Args:
            server: of viser.
            camera: returns the photograph's camera; None, where there is none, picks nothing.
            picked: called with the box; None where it is too small.
        """
        self._server, self._camera, self._picked = server, camera, picked
        self._waiting = False

    def begin(self, client: Any) -> None:
        """Take a client to the photograph's camera, and wait for its next rectangle."""
        camera = self._camera()
        if camera is None:
            return
        look_through(client, camera)
        if self._waiting:
            return
        self._waiting = True

        @self._server.scene.on_rect_select()
        def drawn(event: Any) -> None:
            self._server.scene.remove_rect_select_callback(drawn)
            self._waiting = False
            view, now = event.client.camera, self._camera() or camera
            low, high = (pixel_of(view, now, at) for at in (event.screen_min, event.screen_max))
            if (np.asarray(high) - low < LEAST_PX).any():
                self._picked(None)
                return
            x0, y0, x1, y1 = (round(float(v), 1) for v in (*low, *high))
            self._picked(Box2D(x0=x0, y0=y0, x1=x1, y1=y1))

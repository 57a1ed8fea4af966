"""Sliders for the joints of a scene, in degrees or millimeters."""

import math
from collections.abc import Callable
from typing import Any

from ...spec import SceneSpec
from .scene_editor import joint_range, settable_joints

OnMove = Callable[[str, str, float], None]
"""Callback that receives the name of an object, the key of a joint value, and the value [rad or m].
"""


class JointSliders:
    """Sliders for the joints of the shown scene, in a folder of the page."""

    def __init__(self, server: Any, folder: Any, on_move: OnMove):
        """Create an empty set of sliders for a folder."""
        self._server, self._folder, self._on_move = server, folder, on_move
        self._sliders: list[Any] = []

    def show(self, scene: SceneSpec) -> None:
        """Replace all sliders with sliders for the joints of a scene."""
        for slider in self._sliders:
            slider.remove()
        self._sliders = []
        with self._folder:
            for obj in scene.objects:
                for joint, key in settable_joints(obj):
                    prismatic = joint.type == "prismatic"
                    factor, unit = (1000.0, "mm") if prismatic else (math.degrees(1.0), "deg")
                    # Round the limits inwards to tenths, because the page shows all digits.
                    low, high = (factor * v for v in joint_range(joint))
                    low, high = math.ceil(10 * low - 1e-4) / 10, math.floor(10 * high + 1e-4) / 10
                    if not low < high:
                        continue
                    now = min(max(factor * obj.joint_state.get(key, 0.0), low), high)
                    slider = self._server.gui.add_slider(
                        f"{obj.name} {key}, {unit}", low, high, 0.1, round(now, 1)
                    )
                    slider.on_update(self._moving(slider, obj.name, key, factor))
                    self._sliders.append(slider)
        self._folder.visible = bool(self._sliders)

    def _moving(self, slider: Any, name: str, key: str, factor: float) -> Callable[[Any], None]:
        return lambda _: self._on_move(name, key, slider.value / factor)

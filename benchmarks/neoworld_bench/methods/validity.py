"""Validity of a final scene, by the same rules for every method and for submissions."""

from typing import NamedTuple

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.measure import SceneMeasure, passes
from neoworld_mjx.spec import SceneSpec

from .layout_errors import displaced, unmatched


class Validity(NamedTuple):
    """Components of the validity of a final scene."""

    check_passed: bool
    """True if the final check passes."""
    displaced: tuple[str, ...]
    """Objects that have toppled or fallen compared with the ground truth."""
    missed: tuple[str, ...]
    """Movable objects of the ground truth that the scene lacks."""
    extra: tuple[str, ...]
    """Movable objects of the scene that the ground truth lacks."""
    lost: tuple[str, ...]
    """Missed objects that the method was given: in its initial scene, or in the photograph."""

    @property
    def valid(self) -> bool:
        """True if the final check passes and no object is displaced or lost."""
        return self.check_passed and not self.displaced and not self.lost


def validity(
    scene: SceneSpec,
    measure: SceneMeasure,
    truth: SceneSpec,
    o: RefineOptions,
    *,
    given: SceneSpec | None = None,
) -> Validity:
    """Return the validity of a method's final scene, regardless of the method's verdict.

    Args:
        scene: the final scene.
        measure: measure of the final scene by the final check.
        truth: ground truth of the scene.
        o: options with the bounds of the final check.
        given: initial scene that the method was given. If None, the method was given the
            photograph, which shows every object of the ground truth.
    """
    missed, extra = unmatched(scene, truth)
    had = {item.name for item in (given or truth).objects if not item.static}
    lost = tuple(name for name in missed if name in had)
    away = tuple(displaced(scene, truth))
    return Validity(passes(measure, o), away, tuple(missed), tuple(extra), lost)

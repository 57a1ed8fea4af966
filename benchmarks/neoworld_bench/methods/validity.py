"""Validity of a final scene, the same for every method and for submissions."""

from typing import NamedTuple

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.measure import SceneMeasure, passes
from neoworld_mjx.spec import SceneSpec

from .layout_errors import displaced, unmatched


class Validity(NamedTuple):
    """Validity of a final scene with its components."""

    check_passed: bool
    """True if the final check passes."""
    displaced: tuple[str, ...]
    """Objects that are toppled or have fallen from where the ground truth has them."""
    missed: tuple[str, ...]
    """Movable objects of the ground truth that the scene does not have."""
    extra: tuple[str, ...]
    """Movable objects that the ground truth does not have."""
    lost: tuple[str, ...]
    """Missed objects that the method's initial scene contained."""

    @property
    def valid(self) -> bool:
        """True if the final check passes, nothing is displaced, and nothing given is missed."""
        return self.check_passed and not self.displaced and not self.lost


def validity(
    scene: SceneSpec,
    measure: SceneMeasure,
    truth: SceneSpec,
    o: RefineOptions,
    *,
    given: SceneSpec | None = None,
) -> Validity:
    """Return the validity of a method's final scene; the method's own verdict does not count.

    Args:
        scene: the final scene.
        measure: of it, by the final check.
        truth: the scene's.
        o: options with the bounds of the final check.
        given: the start that the method had; None where it had the picture, which shows every
            object of the ground truth.
    """
    missed, extra = unmatched(scene, truth)
    had = {item.name for item in (given or truth).objects if not item.static}
    lost = tuple(name for name in missed if name in had)
    away = tuple(displaced(scene, truth))
    return Validity(passes(measure, o), away, tuple(missed), tuple(extra), lost)

"""Final alignment: objects that the refinement moved in the image are aligned again.

The alignment of Step 4 does not know the poses at which objects rest. A pear rolls until it rests,
and slices of bread push each other apart, so their contours leave those of the photograph. Here,
they are aligned at the tilts at which they rest, settled again, and checked again.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from ..config import AlignOptions, RefineOptions
from ..estimate.align import align_again
from ..estimate.image.colors import SAME_PX, LabImage, is_supported
from ..estimate.problem import FINE_PX
from ..evidence.evidence import Evidence
from ..measure import SceneMeasure
from ..physics.model import CompiledScene, compile_for_simulation
from ..render import visible_surface
from ..render.rasterize import draw_scene, height_of, pixels_of
from ..spec import SceneSpec, world_poses
from .finishing import check_settled, supports_of

TRIES = 3
"""Largest number of times that the aligned scene is settled and checked. After each time, some
objects get their refined poses back: those that do not rest or agree less with the photograph, and
all objects that carry such an object."""


@dataclass(frozen=True)
class FinalAlignment:
    """Result of `align_final`."""

    scene: SceneSpec
    """The new scene, which passes the final check; the refined scene if no object was aligned."""
    measure: SceneMeasure | None = None
    """Measures of the new scene's final check; None if no object was aligned."""
    aligned: tuple[str, ...] = ()
    """Names of the objects that were aligned again."""
    failure: str = ""
    """Reason why the solver failed; empty if it did not."""


def align_final(
    composed: SceneSpec,
    refined: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    o: RefineOptions | None = None,
    options: AlignOptions | None = None,
    *,
    evidence: Evidence | None = None,
    keep: Collection[str] = (),
    world: CompiledScene | None = None,
) -> FinalAlignment:
    """Align the objects again that the refinement moved in the image.

    The camera and all other objects keep their poses until the scene settles. An object keeps its
    refined pose and size in these cases:

    - The colors of the photograph do not show its contour.
    - It, or an object that it carries, would not rest, or would settle away from its new pose.
    - Its silhouette, or that of an object that it carries, would explain the photograph less well
      than in the refined scene.

    Args:
        composed: the scene before the refinement, aligned with the photograph.
        refined: the refined scene, which passes the final check.
        photo: the photograph (sRGB).
        o: options of settling and of the final check.
        options: options of the alignment.
        evidence: depth image and masks.
        keep: names of objects that are not aligned again.
        world: the compiled scene, at any sizes; by default, the aligned scene is compiled once.

    Returns:
        The new scene, or the refined scene if no object moved in the image, if none can be aligned
        again, without settling, or without a camera.

    Raises:
        PhotoError: the photograph does not have the camera's aspect ratio.
    """
    o, camera = o or RefineOptions(), refined.camera
    unchanged = FinalAlignment(refined)
    if camera is None or not o.settle.enabled:
        return unchanged
    moved = moved_in_image(composed, refined).difference(keep)
    if not moved:
        return unchanged
    again = align_again(refined, photo, moved, options, evidence=evidence)
    accepted = {name for name, change in again.objects.items() if change.evidence == "pixels"}
    if not accepted:
        return FinalAlignment(refined, failure=again.failure)
    bins = LabImage.of(photo, FINE_PX, height_of(camera, FINE_PX)).bins
    owner = draw_scene(refined, camera, FINE_PX).owner
    for _ in range(TRIES):
        placed = _mixed(refined, again.scene, accepted)
        world = world or compile_for_simulation(placed)
        finished = check_settled(world, placed, o)
        rests, shown = finished.rests(o), draw_scene(finished.scene, camera, FINE_PX).owner
        faulty = [
            k
            for k in range(len(rests))
            if not (rests[k] and is_supported(shown == k, owner == k, bins))
        ]
        worse = {name for k in faulty for name in _with_supports(refined, k)} & accepted
        if finished.passed and not worse:
            names = tuple(item.name for item in refined.objects if item.name in accepted)
            return FinalAlignment(finished.scene, finished.measure, names)
        accepted -= worse
        if not (worse and accepted):
            break
    return unchanged


def moved_in_image(before: SceneSpec, after: SceneSpec) -> set[str]:
    """Return the names of the movable objects that moved by more than SAME_PX in the image.

    The displacement is the largest of any vertex, in an image FINE_PX wide. The two scenes have the
    same camera and objects.
    """
    start, end = _pixels(before), _pixels(after)
    return {name for name, at in start.items() if np.abs(end[name] - at).max(initial=0) > SAME_PX}


def _pixels(scene: SceneSpec) -> dict[str, Float[np.ndarray, "vertex 2"]]:
    """Return the vertices of each movable object's visible surface in the image [px]."""
    assert scene.camera is not None
    poses, found = world_poses(scene), {}
    for item in scene.objects:
        if item.parent is not None and not item.static:
            vertices, _ = visible_surface(item.spec, item.joint_state)
            found[item.name] = pixels_of(scene.camera, poses[item.name].apply(vertices), FINE_PX)[0]
    return found


def _mixed(refined: SceneSpec, aligned: SceneSpec, names: set[str]) -> SceneSpec:
    """Return the refined scene with the poses and sizes of some objects from the aligned scene.

    Uncertainties are those of the alignment of Step 4, which include that of the camera.
    """
    objects = [
        new.model_copy(update={"uncertainty": old.uncertainty}) if old.name in names else old
        for old, new in zip(refined.objects, aligned.objects, strict=True)
    ]
    return refined.model_copy(update={"objects": tuple(objects)})


def _with_supports(scene: SceneSpec, k: int) -> set[str]:
    """Return the names of an object, given by index, and of the objects that support it."""
    return {scene.objects[k].name} | supports_of(scene, scene.objects[k])

"""Steps 4 and 5 as two functions: `place` composes and aligns a scene, `refine_placed` refines it.

Runs, rescues of another method's meshes and the benchmark call these two, so that published figures
measure the steps that users run.
"""

import dataclasses
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

from ..compose.compose import Composed, as_parsed, compose, moved_tree
from ..compose.layout_patch import apply_layout, kept_layout
from ..compose.on_supports import put_down
from ..config import AlignOptions, ComposeOptions, RefineOptions
from ..engines import EngineChoice
from ..estimate.align import align, align_to_boxes
from ..estimate.result import Alignment
from ..evidence.evidence import Evidence, PhotoPixels
from ..evidence.known_camera import with_known_camera
from ..measure import SceneMeasure
from ..mllm import Panel, Picture
from ..physics.engine import Engine
from ..physics.model import SceneModel
from ..search.final_alignment import FinalAlignment, align_final
from ..search.scene_refinement import Refined, refine
from ..spec import ObjectSpec, SceneSpec, SceneTree


@dataclass(frozen=True)
class LayoutEstimate:
    """A scene composed and aligned with its evidence."""

    tree: SceneTree
    """The tree, with what the user knows, moved to its 2D boxes."""
    composed: Composed
    """The scene before the alignment with the photograph."""
    scene: SceneSpec
    """The aligned scene, with its objects on their supports."""
    by_boxes: Alignment | None = None
    """Alignment of the parsed objects with their 2D boxes; None without one."""
    alignment: Alignment | None = None
    """The alignment, before its objects were put down; None without one."""
    seconds: float = 0.0
    """Wall time [s]."""


def place(
    tree: SceneTree,
    objects: Mapping[str, ObjectSpec],
    evidence: Evidence | None = None,
    options: ComposeOptions | None = None,
    *,
    name: str = "scene",
) -> LayoutEstimate:
    """Compose a scene, and align it with its 2D boxes, then with all evidence (Step 4).

    Args:
        tree: the scene tree of Step 1.
        objects: built object of every node, by the node's name.
        evidence: the photograph, and what of the tree is evidence.
        options: options of composition and alignment.
        name: name of the scene.

    Raises:
        SpecError: a node has no object.
        PhotoError: the photograph does not have the camera's aspect ratio.
    """
    began = time.perf_counter()
    evidence, options = evidence or Evidence(), options or ComposeOptions()
    known = evidence.camera
    if evidence.masks is not None:
        tree = evidence.masks.with_boxes(tree)
    if known is not None:
        tree = with_known_camera(tree, known)
    tree, by_boxes = evidence.objects.applied(tree, objects), None
    parsed, stated = None, tree.camera_deviations
    if options.refit and evidence.boxes:
        parsed = as_parsed(tree, objects)
        by_boxes = align_to_boxes(
            parsed, measured=tree.camera_measured, stated=stated, evidence=evidence
        )
        tree = moved_tree(tree, parsed, by_boxes.scene)
        tree = evidence.objects.applied(tree, objects)
    composed = _composed(tree, objects, evidence, options, name)
    if evidence.photo is None or not options.align.enabled:
        seconds = time.perf_counter() - began
        return LayoutEstimate(tree, composed, composed.scene, by_boxes, seconds=seconds)
    alignment = align(
        composed.scene,
        photo=evidence.photo,
        options=options.align,
        measured=tree.camera_measured,
        stated=stated,
        evidence=evidence,
        parsed=parsed,
    )
    scene = _with_kept(put_down(alignment.scene), tree, evidence)
    seconds = time.perf_counter() - began
    return LayoutEstimate(tree, composed, scene, by_boxes, alignment, seconds)


def _composed(
    tree: SceneTree,
    objects: Mapping[str, ObjectSpec],
    evidence: Evidence,
    options: ComposeOptions,
    name: str,
) -> Composed:
    """Compose the scene; drop boxes and a camera that are no evidence."""
    composed = compose(tree, objects, options, name=name)
    composed = dataclasses.replace(composed, scene=_with_kept(composed.scene, tree, evidence))
    if evidence.boxes:
        return composed
    bare = tuple(item.model_copy(update={"box2d": None}) for item in composed.scene.objects)
    camera = None if evidence.photo is None else tree.camera
    scene = composed.scene.model_copy(update={"objects": bare, "camera": camera})
    return dataclasses.replace(composed, scene=scene)


def _with_kept(scene: SceneSpec, tree: SceneTree, evidence: Evidence) -> SceneSpec:
    """Return the scene with the objects that the user placed where the tree has them."""
    keep = evidence.objects.keep
    if not keep:
        return scene
    return apply_layout(scene, kept_layout(scene, tree, keep))[0]


@dataclass(frozen=True)
class RefinedPlacement:
    """A refined scene, aligned once more where the refinement had moved objects in the image."""

    scene: SceneSpec
    measure: SceneMeasure
    """Measures of the scene's final check."""
    refined: Refined
    """Result of the search, before the final alignment."""
    final: FinalAlignment | None
    """The final alignment; None if it did not run."""
    seconds: Mapping[str, float]
    """Wall time of each part [s]."""


def refine_placed(
    scene: SceneSpec,
    options: RefineOptions,
    *,
    seed: int = 0,
    engine: Engine | EngineChoice | None = None,
    photo: PhotoPixels | None = None,
    again: AlignOptions | None = None,
    evidence: Evidence | None = None,
    keep: Collection[str] = (),
    model: SceneModel | None = None,
    panel: Panel | None = None,
    progress: Callable[[str], None] | None = None,
) -> RefinedPlacement:
    """Refine a placed scene, and align again the objects that the refinement moved (Step 5).

    Args:
        scene: the placed scene.
        options: options of the refinement and of the final check.
        seed: seed of the search.
        engine: physics engine, or its name; by default, the engine that the options name.
        photo: the photograph (sRGB), for S_sem by a model and for the final alignment.
        again: options of the final alignment; if None, there is none.
        evidence: depth image and masks for the final alignment.
        keep: names of the objects that the final alignment does not move.
        model: the scene compiled for the search, if it is at hand.
        panel: as for `refine`.
        progress: as for `refine`.

    Raises:
        ConfigError, EngineError: as `refine`.
        PhotoError: the photograph does not have the camera's aspect ratio.
    """
    picture, final = None, None
    if photo is not None and options.semantic.scorer == "mllm":
        picture = Picture("photo", photo)
    refined = refine(
        scene if model is None else model,
        options,
        seed=seed,
        engine=engine,
        photo=picture,
        panel=panel,
        progress=progress,
    )
    result, measure, seconds = refined.scene, refined.measure, dict(refined.seconds)
    if photo is not None and again is not None and again.aligns_again and refined.passed:
        began = time.perf_counter()
        # Scenes are compiled at most twice: after a search, both are there.
        world = refined.world if refined.iterations else None
        final = align_final(
            scene, refined.scene, photo, options, again, evidence=evidence, keep=keep, world=world
        )
        seconds["align"] = time.perf_counter() - began
        if final.measure is not None:
            result, measure = final.scene, final.measure
    return RefinedPlacement(result, measure, refined, final, seconds)

"""Steps 4 and 5 of a run and the export: compose, refine, and write the scene's files."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import RunError
from ..io import read_object
from ..parse.photo import load_photo
from ..progress import report
from ..run_folder import CAMERA_NOTE, RunFolder
from ..spec import SceneSpec, SceneTree, read_scene
from .edited_files import edited_objects, moves_from_tree, tree_edited
from .step_context import (
    ALIGNED,
    COMPOSED,
    DEPTH,
    GIVEN,
    OUTLINES,
    PHOTO,
    REFIT,
    RESULT,
    SCALES,
    SCENE,
    SPEC,
    TREE,
    StepContext,
    object_file,
    read_spec,
    read_tree,
    write_files,
)

if TYPE_CHECKING:
    from ..compose.layout_patch import LayoutPatch
    from ..estimate.result import Alignment
    from ..evidence.evidence import Evidence
    from .place import LayoutEstimate

NOTED_M, NOTED_SIZE = 0.10, 0.05
"""Changes of position [m] and size (relative) by the refinement above which a note reports them."""


def compose_scene(context: StepContext) -> None:
    """Step 4: compose the scene of the built objects, and align it with boxes and photograph.

    The step writes tree.json, compose/fit.json, compose/align.json, compose/scene.json,
    compose/scales.json, pictures/outlines.png and, with a depth image, pictures/depth.png, and the
    scene's picture.
    """
    from ..compose.layout_patch import apply_layout, read_layout_patch
    from ..spec.scene import scene_in_frame
    from .given_evidence import evidence_of_tree
    from .place import place

    run, config = context.run, context.config
    options = config.compose
    tree = read_tree(run, before="compose")
    specs = {node.name: run.before("compose", object_file(node.name, SPEC)) for node in tree.nodes}
    edited, by_hand = tree_edited(run), edited_objects(run, tree)
    patch = read_layout_patch(run.path)
    inputs = _inputs(context, tree, specs, patch, by_hand)
    with run.step("compose", inputs) as out:
        if out is not None:
            objects = {name: read_spec(path) for name, path in specs.items()}
            kept, unmatched = evidence_of_tree(run, tree)
            for note in unmatched:
                run.note("compose", note, "no 2D box overlaps it enough")
            # Objects whose programs a person edited keep their sizes, as given assets do.
            assets = kept.objects.assets | {name: objects[name] for name in by_hand}
            evidence = replace(kept, objects=kept.objects.model_copy(update={"assets": assets}))
            placed = place(tree, objects, evidence, options)
            if placed.by_boxes is not None:
                _write_fit(run, placed.tree, placed.by_boxes, out)
            if placed.alignment is not None and evidence.photo is not None:
                start = placed.composed.scene
                _write_alignment(run, start, placed.alignment, evidence, out)
            _note_camera(run, tree, placed)
            scene, base = placed.scene, None
            if scene.camera is not None and evidence.camera is not None:
                base = evidence.camera.base_frame(scene.camera)
            if base is not None:
                scene = scene_in_frame(scene, base)
            scene, stale = apply_layout(scene, patch)
            if evidence.photo is not None and options.looks:
                from ..render.looks import as_photographed

                scene = _with_own_looks(
                    as_photographed(scene, evidence.photo), scene, kept.objects.assets
                )
                if base is not None:
                    scene = scene.model_copy(update={"backdrop": None})
            write_files(out, {COMPOSED: scene.to_json(), SCALES: placed.composed.scales})
            _record_notes(run, placed)
            for outcome, reason in moves_from_tree(tree, placed.scene) if edited else ():
                run.note("compose", outcome, reason)
            _record_patch(run, patch, stale)
    context.draw("compose/picture", COMPOSED, "pictures/before.png")


def _inputs(
    context: StepContext,
    tree: SceneTree,
    specs: Mapping[str, Path],
    patch: "LayoutPatch",
    by_hand: frozenset[str],
) -> dict[str, object]:
    """Return the inputs of the step. If one of them changes, the step runs again."""
    run, config = context.run, context.config
    inputs: dict[str, object] = {"tree": tree, "options": config.compose, **specs}
    inputs |= context.evidence
    if (run.path / PHOTO).is_file():
        inputs["photo"] = run.path / PHOTO
    if patch.objects:
        inputs["layout"] = patch
    if by_hand:
        inputs["sizes"] = sorted(by_hand)
    return inputs


def _write_fit(run: RunFolder, tree: SceneTree, by_boxes: "Alignment", out: Path) -> None:
    """Write the tree at its 2D boxes, and the changes, and note large ones in the run."""
    write_files(out, {TREE: tree.to_json(), REFIT: by_boxes.to_json()})
    if by_boxes.failure:
        run.fallback("compose", "the scene is not aligned with its 2D boxes", by_boxes.failure)
    for outcome, reason in by_boxes.notes("parsed", "its 2D box"):
        run.note("compose", outcome, reason)


def _write_alignment(
    run: RunFolder,
    scene: SceneSpec,
    alignment: "Alignment",
    evidence: "Evidence",
    out: Path,
) -> None:
    """Write the report and the pictures of an alignment, and note large changes in the run.

    Args:
        run: the run.
        scene: the scene before the alignment.
        alignment: the alignment of the scene with the photograph.
        evidence: the photograph, and depth image and masks if there are any.
        out: folder of the step's files.
    """
    from ..render import to_png
    from ..view.evidence_pictures import (
        depth_picture,
        mask_overlaps,
        outline_errors,
        outline_picture,
    )

    report, aligned, photo = alignment.to_json(), alignment.scene, evidence.photo
    if aligned.camera is not None and photo is not None:
        pictures = {OUTLINES: to_png(outline_picture(photo, scene, aligned))}
        before, after = (outline_errors(s, photo) for s in (scene, aligned))
        report["outlines_px"] = {
            name: {"composed": before[name], "aligned": after[name]} for name in after
        }
        if evidence.depth is not None:
            pictures[DEPTH] = to_png(depth_picture(aligned, evidence.depth, photo))
        if evidence.masks is not None:
            before, after = (mask_overlaps(s, evidence.masks) for s in (scene, aligned))
            report["masks_iou"] = {
                name: {"composed": round(before[name], 4), "aligned": round(after[name], 4)}
                for name in after
            }
        write_files(out, pictures)
    write_files(out, {ALIGNED: report})
    if alignment.failure:
        reason = alignment.failure
        run.fallback("compose", "the scene is not aligned with the photograph", reason)
    for number, further in enumerate(evidence.further, 1):
        view = alignment.views.get(further.source)
        if view is not None and view.reason:
            reason = view.reason
            run.fallback("compose", f"{further.source} is not used for the layout", reason)
        elif view is not None:
            shown = (s.model_copy(update={"camera": view.camera}) for s in (scene, aligned))
            picture = to_png(outline_picture(further.photo, *shown))
            write_files(out, {f"pictures/view_{number}.png": picture})
    for outcome, reason in alignment.notes():
        run.note("compose", outcome, reason)


def _with_own_looks(scene: SceneSpec, before: SceneSpec, assets: Collection[str]) -> SceneSpec:
    """Return a scene in which known assets have the materials that they had before."""
    objects = tuple(
        old if item.name in assets else item
        for item, old in zip(scene.objects, before.objects, strict=True)
    )
    return scene.model_copy(update={"objects": objects})


def _note_camera(run: RunFolder, tree: SceneTree, placed: "LayoutEstimate") -> None:
    """Note how the camera differs from that of the response."""
    from ..estimate.result import camera_change

    alignments = [done for done in (placed.by_boxes, placed.alignment) if done is not None]
    camera = placed.scene.camera
    if camera is not None and (change := camera_change(tree.camera, camera, alignments)):
        run.note("compose", CAMERA_NOTE, change)


def _record_notes(run: RunFolder, placed: "LayoutEstimate") -> None:
    for note in placed.composed.notes:
        name, _, change = note.partition(": ")
        record = run.fallback if note in placed.composed.shortfalls else run.note
        record("compose", name, change)


def _record_patch(run: RunFolder, patch: "LayoutPatch", stale: tuple[str, ...]) -> None:
    """Record the objects that a person placed, and those that the scene no longer contains."""
    from ..compose.layout_patch import LAYOUT_PATCH

    for name in sorted(patch.objects.keys() - set(stale)):
        run.note("compose", f"{name} is where a person placed it", f"{LAYOUT_PATCH} contains it")
    for name in stale:
        reason = f"{LAYOUT_PATCH} contains it, but the scene does not"
        run.fallback("compose", f"no {name}", reason)


def refine_layout(context: StepContext) -> None:
    """Step 5: write scene.json, and every candidate's layout and scores in refine/."""
    from ..compose.layout_patch import read_layout_patch
    from ..measure import box_iou, object_moves, scene_checks
    from ..parse.checks import agreement
    from .given_evidence import evidence_of_tree, kept_inputs
    from .place import refine_placed

    run, config = context.run, context.config
    align = config.compose.align
    by_model = config.refine.semantic.scorer == "mllm"
    inputs: dict[str, object] = {
        "scene": run.path / COMPOSED,
        "options": config.refine,
        "seed": config.seed,
    }
    aligns_again = align.aligns_again and (run.path / ALIGNED).is_file()
    if aligns_again:
        inputs |= {"photo": run.path / PHOTO, "align": align, **kept_inputs(run)}

    with run.step("refine", inputs) as out:
        if out is None:
            return
        (out / "refine").mkdir()
        composed = read_scene(run.path / COMPOSED)
        photo = load_photo(run.path / PHOTO).rgb if by_model or aligns_again else None
        placed = refine_placed(
            composed,
            config.refine,
            seed=config.seed,
            photo=photo,
            again=align if aligns_again else None,
            evidence=evidence_of_tree(run, read_tree(run))[0] if aligns_again else None,
            keep=read_layout_patch(run.path).objects,
            panel=context.models,
            progress=lambda line: report(f"  {line}"),
        )
        refined, final, scene = placed.refined, placed.final, placed.scene
        np.savez_compressed(out / "refine" / "history.npz", allow_pickle=False, **refined.history)
        if final is not None and final.failure:
            run.fallback("refine", "no object is aligned again", final.failure)
        if final is not None and final.measure is not None:
            why = "settling or the search had moved it away from its contour in the photograph"
            run.note("refine", f"aligned again: {', '.join(final.aligned)}", why)
        moves = object_moves(composed, scene)
        checks = scene_checks(placed.measure, config.refine)
        metrics = placed.measure.model_dump(mode="json") | {
            "passed": all(check.passed for check in checks),
            "checks": [check.to_json() for check in checks],
            "engine": refined.engine,
            "iterations": refined.iterations,
            "winner": list(refined.winner),
            "before": refined.before.model_dump(mode="json"),
            "box_iou": None,
        }
        # Boxes of a rescue are no evidence.
        if (run.path / TREE).is_file() and not (run.path / GIVEN).is_file():
            tree = read_tree(run, before="program")
            objects = [node for node in tree.nodes if not node.environment]
            parsed = {node.name: agreement(tree, node) for node in objects}
            metrics["box_iou"] = box_iou(parsed, composed, scene)
        write_files(out, {SCENE: scene.to_json(), RESULT: metrics})
        run.record("refine", seconds=placed.seconds)
        for note in refined.fallbacks:
            outcome, _, reason = note.partition(": ")
            run.fallback("refine", outcome, reason)
        for name, move in moves.items():
            if move.distance_m > NOTED_M or abs(move.size_ratio - 1) > NOTED_SIZE:
                run.note(
                    "refine",
                    f"{name} far from its composed pose",
                    f"the refinement moved it by {100 * move.distance_m:.0f} cm, scaled it by "
                    f"{move.size_ratio:.2f} and turned it by {move.yaw_deg:.0f} deg",
                )


def export_files(context: StepContext) -> None:
    """Write the scene and its objects as MJCF, USD and URDF, and a picture of the scene."""
    from ..export import export_scene

    run = context.run
    context.draw("export/picture", SCENE, "pictures/after.png")
    with run.step("export", {"scene": run.path / SCENE}) as out:
        if out is None:
            return
        export_scene(read_scene(run.path / SCENE), out)
        (out / SCENE).unlink(missing_ok=True)  # The step refine has already written it.


def write_metrics(run: RunFolder) -> None:
    """Record the metrics of the refined scene in run.json, if there is a refined scene."""
    if (run.path / RESULT).exists():
        run.record("metrics", **read_object(run.path / RESULT, RunError))
        run.save()

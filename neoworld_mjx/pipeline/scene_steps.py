"""Steps 4 and 5 of a run, and the export: compose, refine and export the scene."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from .. import progress
from ..errors import RunError
from ..io import read_object
from ..mllm import Picture
from ..parse.photo import load_photo
from ..run_folder import RunFolder
from ..spec import SceneSpec, read_scene
from .program_inputs import with_corrected_sizes
from .step_context import (
    ALIGNED,
    ANNOTATION,
    CHECK,
    COMPOSED,
    EVIDENCE,
    OUTLINES,
    REFIT,
    RESPONSE_TREE,
    RESULT,
    SCENE,
    TREE,
    VERIFIED,
    StepContext,
    read_spec,
    read_tree,
)

if TYPE_CHECKING:
    from ..align.alignment import Alignment


def compose_scene(context: StepContext) -> None:
    """Step 4: fit the parsed tree to the built shapes, compose the scene, and align it.

    It is aligned with the photograph; then the rendering of its picture is started.

    The step writes compose/tree.json, compose/fit.json, compose/align.json, compose/scene.json,
    compose/scales.json, pictures/outlines.png and pictures/evidence.png; and, with
    `compose.align.dimensions`, the changed programs, objects/NAME/resized.py, with their objects.
    """
    from ..align.align import align
    from ..align.looks import as_photographed
    from ..compose.compose import compose
    from ..compose.layout_patch import LAYOUT_PATCH, apply_layout, read_layout_patch
    from ..compose.on_supports import in_contact
    from ..fit.refit import refit_tree
    from ..measure import shown_sides
    from .resized_programs import program_files, with_freed_dimensions, write_resized

    run, config = context.run, context.config
    tree = with_corrected_sizes(run, read_tree(run))
    specs = {}
    for node in tree.nodes:
        object_folder = run.path / "objects" / node.name
        repaired = object_folder / VERIFIED
        specs[node.name] = repaired if repaired.is_file() else object_folder / "spec.json"
    refits = config.compose.refit and config.parse.fit
    edited = TREE in run.edited_by_hand("parse")
    # The fit keeps supports that a person chose.
    supports_by_person = edited or (run.path / ANNOTATION).is_file()
    if refits and (run.path / RESPONSE_TREE).is_file() and not edited:
        # Start from the unfitted tree: the first fit has already used the same boxes.
        tree = with_corrected_sizes(run, read_tree(run, RESPONSE_TREE))
    inputs = {"tree": tree, "options": config.compose, "refits": refits, **specs}
    if config.compose.align.enabled or config.compose.looks:
        inputs["photo"] = run.path / "photo.png"
    if config.compose.align.enabled and config.compose.align.dimensions:
        inputs |= {"program": config.program, "verify": config.verify}
        inputs |= program_files(run.path, tree)
    patch = read_layout_patch(run.path)
    if patch.objects:
        inputs["layout"] = patch
    with run.step("compose", inputs) as out:
        if out is not None:
            objects = {name: read_spec(path) for name, path in specs.items()}
            (out / "compose").mkdir()
            if refits:
                visible_sides = shown_sides(compose(tree, objects, config.compose).scene)
                tree, report = refit_tree(
                    tree, objects, visible_sides, change_supports=not supports_by_person
                )
                (out / "compose" / TREE).write_text(tree.to_json(), encoding="utf-8")
                (out / REFIT).write_text(
                    json.dumps(report.to_json(), indent=1) + "\n", encoding="utf-8"
                )
                for outcome, reason in report.notes():
                    run.note("compose", outcome, reason)
                for name, support in report.supports.items():
                    change = f"{name} {support.relation} {support.parent}, not {support.before}"
                    run.note("compose", change, support.phrase())
            composed = compose(tree, objects, config.compose)
            scene, notes, shortfalls = composed.scene, composed.notes, composed.shortfalls
            if config.compose.align.enabled:
                photo = load_photo(run.path / "photo.png").rgb
                known = tree.camera_measured
                alignment = align(scene, photo, config.compose.align, measured=known)
                if config.compose.align.dimensions:
                    freed = with_freed_dimensions(
                        run.path,
                        tree,
                        objects,
                        config,
                        photo,
                        scene,
                        alignment,
                        lambda changed: compose(tree, dict(changed), config.compose).scene,
                    )
                    write_resized(run.path, freed, out)
                    composed = compose(tree, {**objects, **freed.specs}, config.compose)
                    notes, shortfalls = composed.notes, composed.shortfalls
                    alignment = freed.alignment
                write_alignment(run, scene, alignment, photo, out)
                scene, moved = in_contact(alignment.scene, config.compose, composed=composed.scene)
                notes = (*notes, *moved)
            scene, stale = apply_layout(scene, patch, config.compose.gap_m)
            if config.compose.looks:
                scene = as_photographed(scene, load_photo(run.path / "photo.png").rgb)
            (out / COMPOSED).write_text(scene.to_json(), encoding="utf-8")
            scales = json.dumps(composed.scales, indent=1) + "\n"
            (out / "compose" / "scales.json").write_text(scales, encoding="utf-8")
            for note in notes:
                name, _, change = note.partition(": ")
                record = run.fallback if note in shortfalls else run.note
                record("compose", name, change)
            for name in sorted(patch.objects.keys() - set(stale)):
                reason = f"{LAYOUT_PATCH} contains it"
                run.note("compose", f"{name} is where a person placed it", reason)
            for name in stale:
                reason = f"{LAYOUT_PATCH} contains it, but the scene does not"
                run.fallback("compose", f"no {name}", reason)
    context.pictures.begin("compose/picture", run.path / COMPOSED, "pictures/before.png")
    _check_composed(context)


def write_alignment(
    run: RunFolder,
    scene: SceneSpec,
    alignment: "Alignment",
    photo: UInt8[np.ndarray, "row column 3"],
    out: Path,
) -> None:
    """Write the report and the pictures of an alignment, and note large changes in the run.

    Args:
        run: the run.
        scene: the scene before.
        alignment: its alignment with the photograph.
        photo: the photograph (sRGB).
        out: folder of the step's files.
    """
    from ..align.evidence_picture import evidence_picture
    from ..align.outline_error import outline_errors
    from ..align.outline_picture import outline_picture
    from ..render import to_png

    report, aligned = alignment.to_json(), alignment.scene
    if aligned.camera is not None:
        (out / OUTLINES).parent.mkdir(exist_ok=True)
        (out / OUTLINES).write_bytes(to_png(outline_picture(photo, scene, aligned)))
        (out / EVIDENCE).write_bytes(to_png(evidence_picture(aligned, photo)))
        before, after = (outline_errors(s, photo) for s in (scene, aligned))
        report["outlines_px"] = {
            name: {"composed": before[name], "aligned": after[name]} for name in after
        }
    (out / ALIGNED).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    if alignment.failure:
        reason = alignment.failure
        run.fallback("compose", "the scene is not aligned with the photograph", reason)
    for outcome, reason in alignment.notes(scene):
        run.note("compose", outcome, reason)


def _check_composed(context: StepContext) -> None:
    """Write compose/check.json with the objects of the composed scene that do not stay in place.

    Objects that no layout can stabilize become fallbacks of the run; the search may fix the others.
    """
    from ..measure import measured, unstable_objects
    from ..measure.unstable import phrases

    run, limits = context.run, context.config.refine
    bounds = limits.model_dump(
        include={"check_duration_s", "check_timestep_s", "max_depth_m", "max_drift_m"}
        | {"max_tilt_deg"}
    )
    with run.step("compose/check", {"scene": run.path / COMPOSED, "bounds": bounds}) as out:
        if out is None:
            return
        scene = read_scene(run.path / COMPOSED)
        measure = measured(scene, limits)
        moving = unstable_objects(
            scene, measure, max_drift=limits.max_drift_m, max_tilt=limits.max_tilt_deg
        )
        entries = [json.loads(e.model_dump_json()) | {"phrase": e.phrase()} for e in moving]
        (out / CHECK).parent.mkdir()
        text = json.dumps({"unstable": entries}, indent=1) + "\n"
        (out / CHECK).write_text(text, encoding="utf-8")
        if moving:
            count = "1 object does" if len(moving) == 1 else f"{len(moving)} objects do"
            run.note("compose/check", f"{count} not rest before the search", phrases(moving))
        for entry in moving:
            if not entry.held:
                run.fallback("compose/check", f"{entry.name} has no stable support", entry.why)


def refine_layout(context: StepContext) -> None:
    """Step 5: write scene.json, and every candidate's layout and scores in refine/."""
    from ..fit.fit_report import NOTED_M, NOTED_SIZE
    from ..measure import box_iou, object_moves
    from ..refinement import refine

    run, config = context.run, context.config
    by_model = config.refine.semantic.scorer == "mllm"
    photo = None
    if by_model or "s_photo" in config.refine.reward.terms:
        photo = Picture.of("photo", load_photo(run.path / "photo.png").rgb)
    inputs = {"scene": run.path / COMPOSED, "options": config.refine, "seed": config.seed}

    def report(line: str) -> None:
        progress.report(f"  {line}")
        context.pictures.store()

    with run.step("refine", inputs) as out:
        if out is None:
            return
        (out / "refine").mkdir()
        composed = read_scene(run.path / COMPOSED)
        refined = refine(
            composed,
            config.refine,
            seed=config.seed,
            photo=photo,
            panel=context.models,
            scores=out / "refine" / "scores.jsonl" if by_model else None,
            progress=report,
        )
        np.savez_compressed(out / "refine" / "history.npz", allow_pickle=False, **refined.history)
        (out / SCENE).write_text(refined.scene.to_json(), encoding="utf-8")
        moves = object_moves(composed, refined.scene)
        summary = {
            "passed": refined.passed,
            "engine": refined.engine,
            "iterations": refined.iterations,
            "winner": list(refined.winner),
            "finalists_tried": refined.finalists_tried,
            "mean_log_scale": refined.mean_log_scale,
            "mean_shift_m": _mean([move.distance_m for move in moves.values()]),
            "mean_turn_deg": _mean([move.turn_deg for move in moves.values()]),
            "kept": list(refined.kept),
            "rollouts": refined.rollouts,
            "scoring": refined.scoring,
            "layout": {
                name: np.asarray(getattr(refined.layout, name)[0]).tolist()
                for name in ("xy", "yaw", "log_scale")
            },
            "after": refined.measure.model_dump(mode="json"),
            "before": refined.before.model_dump(mode="json"),
        }
        if (run.path / TREE).is_file():  # A rescue has none.
            summary["box_iou"] = box_iou(read_tree(run), composed, refined.scene)
        (out / RESULT).write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
        run.record("refine", seconds=refined.seconds)
        for note in refined.fallbacks:
            outcome, _, reason = note.partition(": ")
            run.fallback("refine", outcome, reason)
        for name, move in moves.items():
            if move.distance_m > NOTED_M or abs(move.size_ratio - 1) > NOTED_SIZE:
                run.note(
                    "refine",
                    f"{name} far from its composed pose",
                    f"the search moved it by {100 * move.distance_m:.0f} cm, scaled it by "
                    f"{move.size_ratio:.2f} and turned it by {move.yaw_deg:.0f} deg",
                )


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else 0.0


def export_files(context: StepContext) -> None:
    """Write the scene and its objects as MJCF, USD and URDF, and a picture of the scene."""
    from ..export import export_scene

    run = context.run
    context.pictures.begin("export/picture", run.path / SCENE, "pictures/after.png")
    with run.step("export", {"scene": run.path / SCENE}) as out:
        if out is None:
            return
        export_scene(read_scene(run.path / SCENE), out)
        (out / SCENE).unlink(missing_ok=True)  # The step refine has already written it.


def write_metrics(run: RunFolder) -> None:
    """Record the metrics of the refined scene in run.json, if it is refined."""
    path = run.path / RESULT
    if not path.exists():
        return
    summary = read_object(path, RunError)
    names = ("mean_log_scale", "mean_shift_m", "mean_turn_deg", "iterations", "engine", "before")
    try:
        values = {name: summary[name] for name in (*names, "passed")}
        values["box_iou"] = summary.get("box_iou")
        run.record("metrics", **summary["after"], **values)
    except (KeyError, TypeError) as error:
        raise RunError(f"{path} lacks {error}; repeat the step with --from refine") from None
    run.save()

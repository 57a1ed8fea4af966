"""Step 5 of a run and the export: refine the layout, and write the scene's files."""

import math

import numpy as np

from ..errors import RunError
from ..io import read_object
from ..parse.photo import load_photo
from ..progress import report
from ..run_folder import RunFolder
from ..spec import read_scene
from .step_context import (
    ALIGNED,
    COMPOSED,
    GIVEN,
    PHOTO,
    RESULT,
    SCENE,
    TREE,
    StepContext,
    read_tree,
    write_files,
)

NOTED_M, NOTED_SIZE = 0.10, 0.05
"""Changes of position [m] and size (relative) by the refinement above which a note reports them."""


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
        summary = {
            "passed": all(check.passed for check in checks),
            "checks": [check.to_json() for check in checks],
            "engine": refined.engine,
            "iterations": refined.iterations,
            "winner": list(refined.winner),
            "finalists_tried": refined.finalists_tried,
            "mean_log_scale": _mean([math.log(move.size_ratio) for move in moves.values()]),
            "mean_shift_m": _mean([move.distance_m for move in moves.values()]),
            "mean_turn_deg": _mean([move.turn_deg for move in moves.values()]),
            "kept": list(refined.kept),
            "rollouts": refined.rollouts,
            "scoring": refined.scoring,
            "layout": {
                name: np.asarray(getattr(refined.layout, name)[0]).tolist()
                for name in ("xy", "yaw", "log_scale")
            },
            "after": placed.measure.model_dump(mode="json"),
            "before": refined.before.model_dump(mode="json"),
        }
        # Boxes of a rescue are no evidence.
        if (run.path / TREE).is_file() and not (run.path / GIVEN).is_file():
            tree = read_tree(run, before="program")
            objects = [node for node in tree.nodes if not node.environment]
            parsed = {node.name: agreement(tree, node) for node in objects}
            summary["box_iou"] = box_iou(parsed, composed, scene)
        write_files(out, {SCENE: scene.to_json(), RESULT: summary})
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


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else 0.0


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
    path = run.path / RESULT
    if not path.exists():
        return
    summary = read_object(path, RunError)
    names = ("mean_log_scale", "mean_shift_m", "mean_turn_deg", "iterations", "engine", "before")
    try:
        values = {name: summary[name] for name in (*names, "passed", "checks")}
        values["box_iou"] = summary.get("box_iou")
        run.record("metrics", **summary["after"], **values)
    except (KeyError, TypeError) as error:
        raise RunError(f"{path} lacks {error}; repeat the step with --from refine") from None
    run.save()

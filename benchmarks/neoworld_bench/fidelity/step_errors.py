"""Errors of every step from a response to a refined scene, on the forty rendered scenes.

Responses are the ground truth with measured errors, and programs have the true shapes, so no model
is needed. The steps are those of a run: the response, the scene composed at its 2D boxes, the scene
aligned with the photograph, and the refined scene.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from neoworld_mjx.config import ComposeOptions, RefineOptions
from neoworld_mjx.errors import EngineError
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.measure import SceneMeasure, measured, passes, visible_box_iou
from neoworld_mjx.physics.colliders import snap_exactly
from neoworld_mjx.physics.engine import open_engine
from neoworld_mjx.pipeline.place import place, refine_placed
from neoworld_mjx.spec import Box3D, SceneSpec

from ..measures.pose_measure import symmetry
from ..rows import Row
from .rendered_responses import exact_response, noisy_response, upright_boxes
from .rendered_scenes import HELD_OUT, TUNED_ON, photo_scene, photograph

STEPS = ("response", "composed", "aligned", "refined")
COMPARED = (("response", "composed"), ("composed", "aligned"), ("aligned", "refined"))
"""Steps before and after. The refinement of a scene that was not aligned is compared with the
composed one."""
MEASURES = ("position_mm", "layout_mm", "heading_deg", "size_percent")
WORSE = {"position_mm": 20.0, "heading_deg": 3.0, "size_percent": 3.0}
"""Growth of an error from which a step counts as having made an object worse."""


class PoseError(Row):
    """Errors of an object after a step."""

    position_mm: float
    """Distance of the center of its foot, in the camera's world frame."""
    layout_mm: float
    """The same without the offset that all objects share."""
    heading_deg: float | None
    """Up to its symmetry; None for round objects."""
    size_percent: float
    """Error of the mean edge."""


class PhotoRow(Row):
    """One object of one scene."""

    scene: int
    name: str
    unsound: bool
    """True if it overlapped another object or moved in free fall in the composed scene; it may then
    move far."""
    valid: dict[str, bool]
    """True if its scene passes the final check, by step."""
    box_iou: dict[str, float]
    """Overlap of its visible box with the photograph's, by step."""
    errors: dict[str, PoseError]
    """By step."""


def photo_rows(
    number: int,
    *,
    search: bool,
    seed: int,
    compose_options: ComposeOptions,
    refine_options: RefineOptions,
    engine: str,
) -> Iterator[PhotoRow]:
    """Run all steps on the noisy response to a scene; yield a row for each object.

    Args:
        number: number of the scene.
        search: whether to refine the composed scene.
        seed: of the search.
        compose_options: of composition; `refit` says whether it moves objects to their 2D boxes.
        refine_options: of the refinement and of the final check.
        engine: that rolls candidates out.

    Raises:
        EngineError: the engine cannot run here.
    """
    o, c = refine_options, compose_options
    runner = open_engine(engine) if search else None  # pyright: ignore[reportArgumentType]
    scene = photo_scene(number)
    truth = exact_response(scene)
    shapes = {item.name: item.spec for item in scene.objects}
    response = noisy_response(truth, number)
    picture = photograph(scene) if c.align.enabled else None
    placed = place(response, shapes, Evidence(picture), c)
    stages = {"composed": placed.composed.scene}
    if placed.alignment is not None:
        stages["aligned"] = placed.scene
    if runner is not None:
        again = c.align if placed.alignment is not None else None
        rested = refine_placed(
            placed.scene, o, seed=seed, engine=runner, photo=picture, again=again
        )
        stages["refined"] = rested.scene
    checks = {
        step: measured(at if step == "refined" else snap_exactly(at), o)
        for step, at in stages.items()
    }
    ious = {step: visible_box_iou(at) for step, at in stages.items()}
    boxes = {"response": {node.name: node.box3d for node in response.nodes}}
    boxes |= {step: upright_boxes(at) for step, at in stages.items()}
    unsound = _unsound(stages["composed"], checks["composed"], o)
    right = {node.name: node.box3d for node in truth.nodes if not node.environment}
    common = {step: _common_shift(of, right) for step, of in boxes.items()}
    for item in scene.objects:
        if item.environment:
            continue
        period = symmetry(item)
        yield PhotoRow(
            scene=number,
            name=item.name,
            unsound=item.name in unsound,
            valid={step: passes(check, o) for step, check in checks.items()},
            box_iou={step: round(of[item.name], 4) for step, of in ious.items()},
            errors={
                step: _error(boxes[step][item.name], right[item.name], common[step], period)
                for step in STEPS
                if step in boxes
            },
        )


def chosen_numbers(scenes: Sequence[int]) -> tuple[int, ...]:
    """Return the numbers of scenes, all forty if there are none.

    Raises:
        EngineError: there is no such scene.
    """
    last = HELD_OUT[-1]
    for number in scenes:
        if not 0 <= number <= last:
            raise EngineError(f"scenes: there is no scene {number}; scenes are 0 to {last}")
    return tuple(scenes or (*TUNED_ON, *HELD_OUT))


def _common_shift(boxes: dict[str, Box3D], right: dict[str, Box3D]) -> Float[np.ndarray, " 3"]:
    """Return the median over objects of how far their positions are off [m]."""
    offs = [np.subtract(boxes[name].position, box.position) for name, box in right.items()]
    return np.median(offs, axis=0)


def _error(box: Box3D, right: Box3D, common: Float[np.ndarray, " 3"], period: float) -> PoseError:
    off = np.subtract(box.position, right.position)
    turn = math.remainder(box.yaw - right.yaw, period) if period > 0 else None
    return PoseError(
        position_mm=round(1e3 * float(np.linalg.norm(off)), 3),
        layout_mm=round(1e3 * float(np.linalg.norm(off - common)), 3),
        heading_deg=None if turn is None else round(abs(math.degrees(turn)), 3),
        size_percent=round(100 * abs(float(np.mean(np.log(np.divide(box.size, right.size))))), 3),
    )


def _unsound(scene: SceneSpec, check: SceneMeasure, o: RefineOptions) -> set[str]:
    """Return the objects of a scene that overlap others or do not stay in place."""
    names = {
        name
        for pair, depth in check.depths_m.items()
        if depth > o.max_depth_m
        for name in pair.split("|")
    }
    stays = lambda n: check.drift_m[n] < o.max_drift_m and check.tilt_deg[n] < o.max_tilt_deg
    names |= {name for name in check.drift_m if not stays(name)}
    # Children move with their parents.
    for item in scene.objects:
        if item.parent in names:
            names.add(item.name)
    return names - {item.name for item in scene.objects if item.environment}


def photo_summary(rows: Sequence[PhotoRow]) -> dict[str, Any]:
    """Summarize rows for each part: errors by step, and the objects that a step made worse."""
    parts = {"tuned_on": TUNED_ON, "held_out": HELD_OUT}
    return {
        part: _figures(part_rows)
        for part, numbers in parts.items()
        if (part_rows := [row for row in rows if row.scene in numbers])
    }


def _figures(rows: Sequence[PhotoRow]) -> dict[str, Any]:
    steps = [step for step in STEPS if step in rows[0].errors]
    scenes = {row.scene: row for row in rows}.values()
    return {
        "scenes": len(scenes),
        "objects": len(rows),
        "steps": {step: _step_figures(rows, step) for step in steps},
        "valid_scenes": {step: sum(s.valid[step] for s in scenes) for step in rows[0].valid},
        "made_worse": {
            after: [line for row in rows for line in _growths(row, before, after)]
            for before, after in COMPARED
            if after in steps
        },
    }


def _step_figures(rows: Sequence[PhotoRow], step: str) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    for name in MEASURES:
        errors = {f"{r.scene}/{r.name}": getattr(r.errors[step], name) for r in rows}
        errors = {key: error for key, error in errors.items() if error is not None}
        if not errors:
            continue
        worst = max(errors, key=errors.__getitem__)
        figures[name] = {
            "median": float(np.median([*errors.values()])),
            "worst": errors[worst],
            "worst_object": worst,
        }
    if step in rows[0].box_iou:
        figures["box_iou"] = float(np.mean([row.box_iou[step] for row in rows]))
    return figures


def _growths(row: PhotoRow, before: str, after: str) -> Iterator[str]:
    """Yield a line for each error that a step made worse, invalid objects excepted."""
    if row.unsound:
        return
    before = before if before in row.errors else "composed"
    for name, bound in WORSE.items():
        old, new = (getattr(row.errors[step], name) for step in (before, after))
        if old is not None and new - old > bound:
            yield f"{row.scene}/{row.name}: {name} {old:.1f} to {new:.1f}"

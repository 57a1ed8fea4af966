"""Share of the 90 % intervals of aligned objects that hold the truth, over rendered scenes."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.spec import SceneObject, SceneSpec, bounds, world_poses
from neoworld_mjx.sweeps.intervals import ratio_interval

from ..dataset.declaration import declaration
from ..dataset.truth_scene import photographed
from ..fidelity.rendered_responses import exact_response
from ..fidelity.rendered_scenes import photograph
from ..noise.initial_scenes import initial_scene, is_evaluation, noise_number
from ..noise.known_evidence import known_evidence
from ..rows import Row
from .layout_errors import heading_deg, offsets

LEVEL, Z = 0.9, 1.645
"""Probability of an interval, and its half-width in standard deviations of a Gaussian."""


class IntervalRow(Row):
    """Error of one number of an aligned object."""

    scene: str
    quantity: str
    """along, across, yaw or log_scale, as in `PoseUncertainty`."""
    evaluation: bool
    """True for initial scenes of the evaluation half."""
    deviations: float
    """Absolute error in stated standard deviations."""


def interval_rows(name: str, starts: int, evidence: Sequence[str] = ()) -> Iterator[IntervalRow]:
    """Yield the errors of a scene's aligned objects from all its initial scenes.

    Args:
        name: name of the scene.
        starts: number of initial scenes.
        evidence: kinds of evidence in addition to the photograph.
    """
    truth = photographed(declaration(name))
    photo, response = photograph(truth), exact_response(truth)
    for start in range(starts):
        initial = initial_scene(truth, response, noise_number(name, 0, start))
        number = noise_number(f"evidence/{name}", 0, start)
        alignment = initial.placed(known_evidence(evidence, truth, photo, number)).alignment
        assert alignment is not None  # A photograph is given.
        absolute = "depth" in evidence
        for quantity, value in object_errors(alignment.scene, truth, absolute=absolute):
            yield IntervalRow(
                scene=name, quantity=quantity, evaluation=is_evaluation(start), deviations=value
            )


def interval_coverage(rows: Sequence[IntervalRow]) -> list[dict[str, Any]]:
    """Return the coverage for each half and quantity, with its 95 % interval over scenes.

    `factor` is the factor on the stated deviations at which exactly 90 % would be covered.
    """
    groups = sorted({(row.evaluation, row.quantity) for row in rows})
    return [_coverage([r for r in rows if (r.evaluation, r.quantity) == g], *g) for g in groups]


def _coverage(rows: list[IntervalRow], evaluation: bool, quantity: str) -> dict[str, Any]:
    held, low, high = ratio_interval(
        ((row.scene, float(row.deviations <= Z), 1.0) for row in rows), share=True
    )
    return {
        "half": "evaluation" if evaluation else "development",
        "quantity": quantity,
        "n": len(rows),
        "held": held,
        "low": low,
        "high": high,
        "factor": float(np.quantile([row.deviations for row in rows], LEVEL) / Z),
    }


def object_errors(
    scene: SceneSpec, truth: SceneSpec, *, absolute: bool = False
) -> Iterator[tuple[str, float]]:
    """Yield the errors of aligned objects, in their stated standard deviations.

    Positions are relative to the support, as the deviations are: a wrong field of view moves the
    whole scene along the view. Objects on walls, of another support than in the ground truth, and
    headings that symmetry makes meaningless or that are stated as not seen do not count.

    Args:
        scene: the aligned scene.
        truth: the ground truth, seen by a camera above the same origin.
        absolute: if True, positions on fixed supports are those in the world. A depth image
            measures objects, and not where a table ends.
    """
    ends, begins = world_poses(scene), world_poses(truth)
    true = {item.name: item for item in truth.objects}
    names = [item.name for item in scene.objects if item.name in true]
    offset = dict(zip(names, offsets(scene, truth, names), strict=True))
    for item in scene.objects:
        known, same = item.uncertainty, true.get(item.name)
        if known is None or same is None or item.parent is None or same.parent != item.parent:
            continue
        if item.relation == "attached" or item.parent not in offset:
            continue
        on_fixed = true[item.parent].parent is None
        off = offset[item.name] - (0.0 if absolute and on_fixed else offset[item.parent])
        view = ends[item.name].pos[:2] / np.linalg.norm(ends[item.name].pos[:2])
        yield "along", abs(float(off @ view)) / known.along
        yield "across", abs(float(off @ [-view[1], view[0]])) / known.across
        turn = heading_deg(same, ends[item.name], begins[item.name])
        if turn is not None and known.yaw is not None:
            yield "yaw", math.radians(turn) / known.yaw
        yield "log_scale", abs(math.log(_diagonal(item) / _diagonal(same))) / known.log_scale


def _diagonal(item: SceneObject) -> float:
    return float(np.linalg.norm(np.subtract(*bounds(item.spec, item.joint_state))))

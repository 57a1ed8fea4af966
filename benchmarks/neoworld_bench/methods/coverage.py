"""Calibration: share of the 90 % intervals of aligned objects that contain the truth."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from neoworld_mjx.align.align import align
from neoworld_mjx.spec import SceneObject, SceneSpec, bounds, world_poses
from neoworld_mjx.sweeps.intervals import ratio_interval

from ..dataset.declaration import declaration
from ..dataset.truth_scene import photographed
from ..fidelity.rendered_responses import exact_response
from ..fidelity.rendered_scenes import photograph
from ..noise.initial_scenes import initial_scene, is_evaluation, noise_number
from ..rows import Row
from .layout_errors import heading_deg, offsets

LEVEL, Z = 0.9, 1.645
"""Probability of an interval, and its half-width in standard deviations of a Gaussian."""


class CoverageRow(Row):
    """Error of one number of an aligned object."""

    scene: str
    start: int
    """Number of the initial scene."""
    quantity: str
    """along, across, yaw or log_scale, as in `PoseUncertainty`."""
    deviations: float
    """Absolute error in stated standard deviations."""


def coverage_rows(name: str, *, starts: int, seed: int = 0) -> Iterator[CoverageRow]:
    """Align a scene's initial scenes with the photograph, and yield the errors of its objects.

    Args:
        name: name of the scene.
        starts: number of initial scenes.
        seed: of the noise.
    """
    truth = photographed(declaration(name))
    photo, response = photograph(truth), exact_response(truth)
    for start in range(starts):
        composed = initial_scene(truth, response, noise_number(name, seed, start)).scene
        for quantity, value in object_errors(align(composed, photo).scene, truth):
            yield CoverageRow(scene=name, start=start, quantity=quantity, deviations=value)


def coverage_table(rows: Sequence[CoverageRow]) -> list[dict[str, Any]]:
    """Return by half and quantity the share of intervals that contain the truth.

    "low" and "high" are the ends of the share's interval, clustered by scene. "factor" is by how
    much the stated deviations must grow so that LEVEL of the intervals contain the truth.
    """
    table = []
    for evaluation in (False, True):
        half = [row for row in rows if is_evaluation(row.start) == evaluation]
        for quantity in dict.fromkeys(row.quantity for row in half):
            some = [row for row in half if row.quantity == quantity]
            share, low, high = ratio_interval(
                ((row.scene, float(row.deviations <= Z), 1.0) for row in some), share=True
            )
            largest = float(np.quantile([row.deviations for row in some], LEVEL))
            table.append(
                {
                    "half": "evaluation" if evaluation else "development",
                    "quantity": quantity,
                    "n": len(some),
                    "contained": share,
                    "low": low,
                    "high": high,
                    "factor": largest / Z,
                }
            )
    return table


def object_errors(scene: SceneSpec, truth: SceneSpec) -> Iterator[tuple[str, float]]:
    """Yield the errors of aligned objects, in their stated standard deviations.

    Positions are relative to the support, as the deviations are: a wrong field of view moves the
    whole scene along the view. Objects on walls, of another support than in the ground truth, and
    headings that symmetry makes meaningless do not count.

    Args:
        scene: the aligned scene.
        truth: the ground truth, seen by a camera above the same origin.
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
        off = offset[item.name] - offset[item.parent]
        view = ends[item.name].pos[:2] / np.linalg.norm(ends[item.name].pos[:2])
        yield "along", abs(float(off @ view)) / known.along
        yield "across", abs(float(off @ [-view[1], view[0]])) / known.across
        turn = heading_deg(same, ends[item.name], begins[item.name])
        if turn is not None:
            yield "yaw", math.radians(turn) / known.yaw
        yield "log_scale", abs(math.log(_diagonal(item) / _diagonal(same))) / known.log_scale


def _diagonal(item: SceneObject) -> float:
    return float(np.linalg.norm(np.subtract(*bounds(item.spec, item.joint_state))))

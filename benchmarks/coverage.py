"""Share of the 90 % intervals of aligned objects that hold the truth, over rendered scenes."""

import logging
import math
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
from neoworld_bench.dataset.declaration import declaration, declarations
from neoworld_bench.dataset.truth_scene import photographed
from neoworld_bench.fidelity.rendered_responses import exact_response
from neoworld_bench.fidelity.rendered_scenes import photograph
from neoworld_bench.machine import machine
from neoworld_bench.methods.layout_errors import heading_deg, offsets
from neoworld_bench.noise.initial_scenes import initial_scene, is_evaluation, noise_number

from benchmarks.suites import Coverage
from neoworld_mjx.align.align import align
from neoworld_mjx.spec import SceneObject, SceneSpec, bounds, world_poses
from neoworld_mjx.sweeps.intervals import ratio_interval

log = logging.getLogger(__name__)

LEVEL, Z = 0.9, 1.645
"""Probability of an interval, and its half-width in standard deviations of a Gaussian."""


class Error(NamedTuple):
    """Error of one number of an aligned object."""

    scene: str
    quantity: str
    """along, across, yaw or log_scale, as in `PoseUncertainty`."""
    evaluation: bool
    """True for initial scenes of the evaluation half."""
    deviations: float
    """Absolute error in stated standard deviations."""


def run_suite(options: Coverage) -> dict[str, Any]:
    """Align initial scenes, and count the intervals that hold the truth."""
    names = list(declarations())[: options.scenes]
    work = partial(_errors_of_scene, starts=options.starts)
    errors: list[Error] = []
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for name, found in zip(names, pool.map(work, names), strict=True):
            errors += found
            log.info("%s: %d numbers", name, len(found))
    groups = [(half, quantity) for half in (False, True) for quantity in ("along", "across", "yaw")]
    groups += [(half, "log_scale") for half in (False, True)]
    return {"machine": machine(), "table": [_row(errors, *group) for group in sorted(groups)]}


def _row(errors: list[Error], evaluation: bool, quantity: str) -> dict[str, Any]:
    some = [e for e in errors if (e.quantity, e.evaluation) == (quantity, evaluation)]
    held, low, high = ratio_interval(
        ((e.scene, float(e.deviations <= Z), 1.0) for e in some), share=True
    )
    deviations = [e.deviations for e in some]
    return {
        "half": "evaluation" if evaluation else "development",
        "quantity": quantity,
        "n": len(some),
        "held": held,
        "low": low,
        "high": high,
        "factor": float(np.quantile(deviations, LEVEL) / Z) if some else math.nan,
    }


def _errors_of_scene(name: str, starts: int) -> list[Error]:
    """Return the errors of a scene's aligned objects from all its initial scenes."""
    truth = photographed(declaration(name))
    photo, response = photograph(truth), exact_response(truth)
    found = []
    for start in range(starts):
        composed = initial_scene(truth, response, noise_number(name, 0, start)).scene
        aligned = align(composed, photo).scene
        found += [
            Error(name, quantity, is_evaluation(start), value)
            for quantity, value in object_errors(aligned, truth)
        ]
    return found


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

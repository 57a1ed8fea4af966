"""Wrong and right cameras of responses about rendered scenes, and those that the parse notices."""

import logging
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from neoworld_bench.dataset.declaration import declarations
from neoworld_bench.dataset.truth_scene import photographed
from neoworld_bench.fidelity.rendered_responses import exact_response, noisy_response
from neoworld_bench.fidelity.rendered_scenes import photo_scene, photograph
from neoworld_bench.machine import machine
from neoworld_bench.noise.parse_noise import NoiseLog, with_misjudged_view

from benchmarks.suites import Cameras
from neoworld_mjx.fit.vertical_edges import VerticalEdges
from neoworld_mjx.parse.camera_checks import LEAST_DEVIATION, contradicts, deviation, edges_of
from neoworld_mjx.spec import SceneSpec, SceneTree

log = logging.getLogger(__name__)

PITCH_OFF = math.radians(4.6)
"""Error of a wrong pitch [rad]: that of a response to a real photograph, by a sensor's depth."""
SIGMAS = (2.5, 3.5, 5.0)
"""Significances at which cameras are counted [standard deviations]; the parse's is 3.5."""


def run_suite(options: Cameras) -> dict[str, Any]:
    """Count the cameras that contradict the vertical edges of their pictures, by set and kind."""
    found: dict[tuple[str, str], list[VerticalEdges | None]] = {}
    for group, scene in _scenes(options):
        truth, picture = exact_response(scene), photograph(scene)
        for kind, tree in _responses(truth, options.responses):
            found.setdefault((group, kind), []).append(edges_of(picture, tree))
        log.info("%s %s", group, scene.name)
    table = [
        {
            "set": group,
            "camera": kind,
            "cameras": len(results),
            "with_edges": sum(edges is not None for edges in results),
            "noticed": sum(edges is not None and contradicts(edges) for edges in results),
            **{f"at_{sigma:g}": sum(_at(sigma, edges) for edges in results) for sigma in SIGMAS},
        }
        for (group, kind), results in found.items()
    ]
    return {"machine": machine(), "table": table}


def _at(sigma: float, edges: VerticalEdges | None) -> bool:
    """Return whether edges exclude a camera with another significance than the parse's."""
    return edges is not None and bool(edges.sigma > sigma) and deviation(edges) > LEAST_DEVIATION


def _scenes(options: Cameras) -> Iterator[tuple[str, SceneSpec]]:
    for declared in list(declarations().values())[: options.scenes]:
        yield "dataset", photographed(declared)
    for number in range(options.photos):
        yield "photos", photo_scene(number)


def _responses(truth: SceneTree, count: int) -> Iterator[tuple[str, SceneTree]]:
    """Yield kinds of cameras and responses: right ones, wrong fields of view, and wrong pitches."""
    yield "exact", truth
    for number in range(count):
        response = noisy_response(truth, number)
        yield "noise", response
        yield "fovy off", _misjudged(response, number)
        pitch = truth.camera.pitch + PITCH_OFF * (1 if number % 2 else -1)
        camera = response.camera.model_copy(update={"pitch": pitch})
        yield "pitch off", response.model_copy(update={"camera": camera})


def _misjudged(response: SceneTree, number: int) -> SceneTree:
    """Return a response with a wrong field of view, drawn until it is wrong."""
    draw = 0
    while True:
        noise = NoiseLog()
        tree = with_misjudged_view(response, np.random.default_rng((number, 47, draw)), noise)
        if noise.injected:
            return tree
        draw += 1

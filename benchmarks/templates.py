"""Builds, checks and object tests of all templates, at their defaults and at random parameters."""

import os
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from neoworld_bench.machine import machine
from neoworld_bench.rows import collect
from PIL import Image, ImageDraw
from pydantic import BaseModel

from benchmarks.suites import Templates
from neoworld_mjx.checks.compile_checks import check
from neoworld_mjx.checks.object_tests import run_object_tests
from neoworld_mjx.program.sandbox import run
from neoworld_mjx.program.views import open_state
from neoworld_mjx.render import View, render_object, visible_vertices
from neoworld_mjx.spec import ObjectSpec, bounds
from neoworld_mjx.templates import template, templates
from neoworld_mjx.templates.template import BOX

SIDE, COLUMNS = 150, 12
"""Size of an image in the contact sheet [px], and images per row: two for each template."""


class TemplateRow(BaseModel):
    """One instance of a template."""

    template: str
    seed: int | None
    """None for the defaults."""
    joints: int
    """Number of movable joints."""
    passed: bool
    """True if it builds to its box and passes the compile checks and the object tests."""
    failed: list[str] = []
    battery_s: float = 0.0


def run_suite(options: Templates) -> dict[str, Any]:
    """Run the suite."""
    began = time.perf_counter()
    names = list(options.name or templates())
    seeds = [None, *range(options.seeds)]
    tasks = [(name, seed) for name in names for seed in seeds]
    workers = options.workers or os.cpu_count() or 1
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        rows = collect(pool.map(_instance, tasks))
        if options.sheet is not None:
            _draw_sheet(options.sheet, names, list(pool.map(_pictures, names)))
    defaults = [row for row in rows if row.seed is None]
    return {
        "categories": len(names),
        "joints": sum(row.joints for row in defaults),
        "instances": len(rows),
        "instances_passed": sum(row.passed for row in rows),
        "passed": all(row.passed for row in rows),
        "failed": [row.model_dump() for row in rows if not row.passed],
        "seconds": time.perf_counter() - began,
        "machine": machine(),
    }


def _instance(task: tuple[str, int | None]) -> TemplateRow:
    name, seed = task
    drawn = template(name)
    values = {} if seed is None else drawn.draw(seed)
    built = run(drawn.program(values))
    if built.spec is None:
        failed = [f"{s.code}: {s.message}" for s in built.signals]
        return TemplateRow(template=name, seed=seed, joints=0, passed=False, failed=failed)
    spec = built.spec
    signals = check(spec, None, built.lines, built.allowances)
    failed = [f"{s.code}: {s.message}" for s in signals if s.severity == "error"]
    low, high = bounds(spec)
    wanted = np.array([float(values.get(k, drawn.parameters[k].default)) for k in BOX])
    if (np.abs(high - low - wanted) > np.maximum(0.003, 0.02 * wanted)).any():
        failed.append(f"box: {np.round(high - low, 4).tolist()} in place of {wanted.tolist()}")
    began = time.perf_counter()
    verdict = run_object_tests(spec, allowed=built.allowances, threads=1).verdict
    failed += [
        f"{c.scenario} {c.name}: {c.value} over {c.threshold} {c.unit} {c.joint or c.part or ''}"
        for c in verdict.checks
        if c.outcome in ("FAIL", "TOOL_FAILURE")
    ]
    return TemplateRow(
        template=name,
        seed=seed,
        joints=sum(joint.type != "fixed" for joint in spec.joints),
        passed=not failed,
        failed=failed,
        battery_s=time.perf_counter() - began,
    )


def _pictures(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Render an object at rest and opened, with the same camera."""
    spec = run(template(name).program()).spec
    assert spec is not None
    states = ({}, open_state(spec))
    points = np.vstack([visible_vertices(spec, state) for state in states])
    view = View.framing(points, width=SIDE, height=SIDE)
    rest, opened = (_picture(spec, state, view) for state in states)
    return rest, opened


def _picture(spec: ObjectSpec, state: dict[str, float], view: View) -> np.ndarray:
    return np.array(render_object(spec, state, view, width=SIDE, height=SIDE).color)


def _draw_sheet(path: Path, names: list[str], pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    rows = -(-2 * len(names) // COLUMNS)
    caption = 14
    sheet = Image.new("RGB", (COLUMNS * SIDE, rows * (SIDE + caption)), "white")
    text = ImageDraw.Draw(sheet)
    for k, (name, pair) in enumerate(zip(names, pairs, strict=True)):
        for j, picture in enumerate(pair):
            row, column = divmod(2 * k + j, COLUMNS)
            sheet.paste(Image.fromarray(picture), (column * SIDE, row * (SIDE + caption) + caption))
            if not j:
                at = (column * SIDE + 2, row * (SIDE + caption) + 1)
                text.text(at, templates()[name].label, fill="black")
    sheet.save(path, quality=80)

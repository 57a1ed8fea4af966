"""Programs: hostile programs and mutants in the sandbox, cavities of vessels, build times."""

import logging
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from neoworld_bench.machine import Others, machine

from benchmarks.suites import Programs
from neoworld_mjx.checks.compile_checks import check
from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.export import export_object
from neoworld_mjx.program.sandbox import run
from tests.support.hostile import HOSTILE, contain
from tests.support.mutants import crashed
from tests.support.vessels import VESSELS, held

log = logging.getLogger(__name__)

CABINET = """
from neoworld_mjx.program.sdk import Object, box, cylinder, grid, hollow_box, sweep

# A sideboard, 0.45 x 1.64 x 0.86 m: four columns, each with a drawer above a door.
X, Y, Z, WALL = 0.40, 1.64, 0.72, 0.02
TURNED = (0, 1.5708, 0)

cabinet = Object("sideboard", label="sideboard with four drawers and four doors")
cabinet.material("white", like="mdf", rgb=(0.90, 0.89, 0.86))
carcass = cabinet.part("carcass", material="white")
shell = carcass.add(hollow_box((X, Y, Z), WALL, open="+x"), at=(0, 0, 0.08), by="bottom")
x = shell.anchor("front")[0]
for i, (px, py, _) in enumerate(grid((2, 2), (X - 0.08, Y - 0.08))):
    foot = cabinet.part(f"foot_{i}", material="steel")
    foot.add(cylinder(0.02, 0.08), at=(px, py, 0), by="bottom")
    cabinet.fixed(f"screw_{i}", carcass, foot)
for i in range(3):
    panel = cabinet.part(f"partition_{i}", material="white")
    place = (WALL / 2, -0.405 + 0.405 * i, 0.10)
    panel.add(box((X - WALL, WALL, Z - 2 * WALL)), at=place, by="bottom")
    cabinet.fixed(f"dowel_{i}", carcass, panel)
for i in range(4):
    middle = -0.6075 + 0.405 * i
    low, high = middle - 0.1925, middle + 0.1925
    shelf = cabinet.part(f"shelf_{i}", material="white")
    shelf.add(box((X - 2 * WALL, 0.385, WALL)), at=(0, middle, 0.58))
    cabinet.fixed(f"rest_{i}", carcass, shelf)
    drawer = cabinet.drawer(
        f"drawer_{i}", carcass, x=x, y=(low, high), z=(0.59, 0.78), depth=0.34, overlay=0.008
    )
    door = cabinet.door(
        f"door_{i}", carcass, x=x, y=(low, high), z=(0.08, 0.578),
        hinge="left", opens=1.3,
    )
    px, py, pz = drawer.anchor("front")
    bar = [
        (px, py - 0.06, pz), (px + 0.02, py - 0.06, pz),
        (px + 0.02, py + 0.06, pz), (px, py + 0.06, pz),
    ]
    pull = cabinet.part(f"pull_{i}", material="steel")
    pull.add(sweep(bar, radius=0.005))
    cabinet.fixed(f"bolt_{i}", drawer, pull)
    knob = cabinet.part(f"knob_{i}", material="steel")
    spot = (door.anchor("front")[0], middle - 0.15, 0.40)
    knob.add(cylinder(0.012, 0.02), at=spot, rpy=TURNED, by="back")
    cabinet.fixed(f"pin_{i}", door, knob)
top = cabinet.part("top", material="oak")
top.add(box((X + 0.05, Y, 0.02)), at=carcass.anchor("back.top"), by="back.bottom")
cabinet.fixed("glue", carcass, top)
back = cabinet.part("rail", material="oak")
back.add(box((0.02, Y, 0.04)), at=top.anchor("back.top"), by="back.bottom")
cabinet.fixed("nails", top, back)
"""
"""Program with 30 parts and 8 movable joints."""


def programs(
    *,
    hostile: bool = True,
    neighbours: int = 0,
    mutations: int = 5000,
    repeats: int = 9,
    seed: int = 0,
) -> dict[str, Any]:
    """Run hostile programs and mutants of the guide's programs, and time the cabinet.

    Args:
        hostile: whether to run hostile programs.
        neighbours: processes that keep the cores busy beside them.
        mutations: number of mutants.
        repeats: repetitions of each timing; the result has medians.
        seed: seed of the mutations.

    Raises:
        ConfigError: a number is out of range.
    """
    if mutations < 0 or repeats < 1:
        raise ConfigError("mutations must not be negative, repeats at least 1")
    ends = []
    with _busy(neighbours):
        for name in HOSTILE if hostile else ():
            ends.append(contain(name))
            if ends[-1].why:
                log.info(f"hostile {name}: {ends[-1].why}")
    log.info(f"hostile programs: {sum(not e.why for e in ends)} of {len(ends)} contained")
    bad = crashed(seed, mutations)
    log.info(f"mutants: {len(bad)} of {mutations} crashed")
    vessels = [held(name) for name in VESSELS]
    return {
        "hostile_total": len(ends),
        "hostile_contained": sum(not end.why for end in ends),
        "hostile_slowest_s": max((end.seconds for end in ends), default=0.0),
        "hostile_growth_mb": max((end.grown_mb for end in ends), default=0.0),
        "hostile_faults": [{"name": end.name, "why": end.why} for end in ends if end.why],
        "mutations_total": mutations,
        "mutation_crashes": len(bad),
        "mutants_that_crashed": bad[:5],
        **cabinet_times(repeats),
        "cavities_total": len(vessels),
        "cavities_that_hold": sum(vessel.holds for vessel in vessels),
        "cavities": [{**vessel._asdict(), "ratio": vessel.ratio} for vessel in vessels],
        "machine": machine(),
    }


def cabinet_times(repeats: int) -> dict[str, Any]:
    """Time the cabinet's build, its checks over the joint ranges, and its three exports."""
    options = ProgramOptions(check_timeout_s=30.0)
    built = run(CABINET, options)
    assert built.spec is not None, built.signals
    spec = built.spec
    signals = check(spec, options, built.lines)
    others = Others()
    with tempfile.TemporaryDirectory() as folder:
        times = {
            "warm_build_ms": _median_ms(lambda: run(CABINET, options), repeats),
            "checks_ms": _median_ms(lambda: check(spec, options), repeats),
            "export_ms": _median_ms(lambda: export_object(spec, Path(folder)), repeats),
        }
    return {
        **times,
        "repeats": repeats,
        "cores_others_used": others.cores(),
        "parts": len(spec.parts),
        "joints": sum(joint.type != "fixed" for joint in spec.joints),
        "signals": [signal.phrase() for signal in signals],
    }


def _median_ms(work: Callable[[], Any], repeats: int) -> float:
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


@contextmanager
def _busy(count: int) -> Iterator[None]:
    """Keep cores busy within the context."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def run_suite(o: Programs) -> dict[str, Any]:
    """Test the sandbox and time a cabinet."""
    return programs(
        hostile=not o.no_hostile,
        neighbours=o.neighbours,
        mutations=o.mutations,
        repeats=o.repeats,
        seed=o.seed,
    )

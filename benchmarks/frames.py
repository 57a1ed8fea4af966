"""Load time and frame rate of the page of `neoworld view` in a Chromium with software rendering."""

import os
import statistics
import time
from pathlib import Path
from typing import Any

from neoworld_bench.machine import machine
from neoworld_mjx.view.pages.local_server import address, close_server, open_server
from neoworld_mjx.view.pages.scene_viewer import SceneViewer
from neoworld_mjx.view.pages.view_target import open_target

from benchmarks.suites import Frames
from neoworld_mjx.config import Config
from neoworld_mjx.pipeline import rebuild, search_again
from tests.support.browser import Page, opened

COUNT = """() => { window.frames_at = []; const next = t => { window.frames_at.push(t);
requestAnimationFrame(next); }; requestAnimationFrame(next); }"""


def run_suite(options: Frames) -> dict[str, Any]:
    """Open the page of a scene, and rotate the view for some seconds."""
    begun = time.perf_counter()
    target = open_target(options.scene, Config())
    server = open_server("frames", port=0)
    try:
        SceneViewer(
            *(server, options.scene, target, Config()), rebuild=rebuild, search_again=search_again
        )
        served_s = time.perf_counter() - begun
        rows = [_visit(address(server), options.seconds) for _ in range(options.visits)]
    finally:
        close_server(server)
    return {
        "objects": len(target.after.objects),
        "served_s": round(served_s, 2),
        "frames_per_s": statistics.median(row["frames_per_s"] for row in rows),
        "processor_ms": statistics.median(row["processor_ms"] for row in rows),
        "main_thread_ms": statistics.median(row["main_thread_ms"] for row in rows),
        "machine": machine(),
        "rows": rows,
    }


def _visit(url: str, seconds: float) -> dict[str, float]:
    begun = time.perf_counter()
    with opened(url) as page:
        page.page.get_by_text("Free fall").first.wait_for()
        shown_s = time.perf_counter() - begun
        page.settled(right=500)
        page.page.evaluate(COUNT)
        session = page.page.context.new_cdp_session(page.page)
        session.send("Performance.enable")
        before, busy = _main_thread_s(session), _processor_s()
        _turn(page, seconds)
        times = page.page.evaluate("window.frames_at")
        count = max(len(times) - 1, 1)
        return {
            "browser_and_page_s": round(shown_s, 2),
            "frames": count,
            "frames_per_s": round(1000 * count / max(times[-1] - times[0], 1.0), 2),
            "processor_ms": round(1000 * (_processor_s() - busy) / count, 1),
            "main_thread_ms": round(1000 * (_main_thread_s(session) - before) / count, 2),
        }


def _processor_s() -> float:
    """Return the processor time of all child processes [s].

    Unlike the frame rate it hardly depends on other load.
    """
    children: dict[int, list[int]] = {}
    seconds: dict[int, float] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue  # The process has ended.
        children.setdefault(int(fields[1]), []).append(int(folder.name))
        ticks = int(fields[11]) + int(fields[12])
        seconds[int(folder.name)] = ticks / os.sysconf("SC_CLK_TCK")
    total, parents = 0.0, [os.getpid()]
    while parents:
        for child in children.get(parents.pop(), []):
            total += seconds[child]
            parents.append(child)
    return total


def _main_thread_s(session: Any) -> float:
    metrics = session.send("Performance.getMetrics")["metrics"]
    return next(metric["value"] for metric in metrics if metric["name"] == "TaskDuration")


def _turn(page: Page, seconds: float) -> None:
    """Rotate the view with the mouse for some seconds."""
    mouse, begun = page.page.mouse, time.perf_counter()
    mouse.move(260, 300)
    mouse.down()
    step = 0
    while time.perf_counter() - begun < seconds:
        step += 1
        mouse.move(260 + 4 * (step % 20 - 10), 300 + step % 7)
        time.sleep(0.03)
    mouse.up()

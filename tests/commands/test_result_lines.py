"""Summaries of runs say what the user would otherwise not notice."""

from neoworld_mjx.commands.result_lines import run_lines


def test_a_summary_tells_a_replaced_camera():
    change = "field of view 25.3 -> 19.1 degrees (estimated from: contours)"
    notes = [
        {"step": "compose", "what": "camera", "why": change},
        {"step": "refine", "what": "aligned again: cup", "why": "it had moved"},
    ]
    result = {
        "passed": True, "checks": [], "scene": "scene.xml", "report": "report.html",
        "objects": ["cup"], "fallbacks": [], "notes": notes, "mllm": {}, "seconds": {},
        "waiting": {},
    }  # fmt: skip
    assert [row for row in run_lines(result) if "cup" in row or "25.3" in row] == [
        f"camera: {change}"
    ]

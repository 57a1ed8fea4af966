"""Errors of noisy responses to rendered scenes, step by step."""

import json

import numpy as np
import pytest
from neoworld_bench.fidelity.rendered_scenes import occluders, photo_scene, visible_shares
from neoworld_bench.fidelity.step_errors import (
    MEASURES,
    STEPS,
    PhotoRow,
    PoseError,
    photo_rows,
    photo_summary,
)

from neoworld_mjx import cli
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import EngineError


@pytest.mark.slow
def test_each_step_reduces_the_errors():
    scenes, cem = (8, 10, 22, 29), {"population": 48, "iterations": 3}
    options = RefineOptions.model_validate({"check_duration_s": 0.3, "cem": cem})
    rows = list(photo_rows(scenes, refine_options=options))
    summary = photo_summary(rows)
    assert set(summary) == {"tuned_on", "held_out"}
    assert {row.scene for row in rows} == set(scenes)
    median = {
        (step, name): np.median([v for row in rows if (v := getattr(row.errors[step], name))])
        for step in STEPS
        for name in MEASURES
    }
    # What the answer has wrong is there to be repaired.
    assert median["answer", "layout_mm"] > 8
    for step in ("composed", "refined"):
        assert median[step, "layout_mm"] < 0.75 * median["answer", "layout_mm"]
        assert median[step, "size_percent"] < median["answer", "size_percent"] + 1.0
    for part in summary.values():
        steps = part["steps"]
        assert steps["composed"]["box_iou"] > steps["as_answered"]["box_iou"] + 0.02
        assert steps["refined"]["box_iou"] > steps["composed"]["box_iou"] - 0.01
        assert part["valid_scenes"]["refined"] >= part["valid_scenes"]["composed"]
        assert all(len(lines) <= 1 for lines in part["made_worse"].values())


def test_occluders_are_named():
    # A block in a bin: each hides a part of the other.
    scene = photo_scene(3, width=320)
    hidden_by = occluders(scene)
    assert hidden_by["bin_3_in"] == ("bin_3",) and "bin_3_in" in hidden_by["bin_3"]
    assert hidden_by["mug_0"] == ()
    shares = visible_shares(scene)
    assert shares["mug_0"] == 1.0 and 0.3 < shares["bin_3_in"] < 0.97


def test_objects_that_a_step_made_worse_are_listed_unless_invalid_before():
    def error(mm, percent=1.0):
        return PoseError(position_mm=mm, layout_mm=mm, heading_deg=None, size_percent=percent)

    def row(name, *, unsound):
        return PhotoRow(
            scene=3,
            name=name,
            unsound={"as_answered": False, "composed": unsound},
            valid={"composed": True, "refined": True},
            box_iou={"composed": 0.8, "refined": 0.7},
            errors={
                "answer": error(30.0),
                "fit": error(10.0),
                "composed": error(10.0),
                "refined": error(40.0, 9.0),
            },
        )

    summary = photo_summary([row("cup", unsound=False), row("can", unsound=True)])
    worse = summary["tuned_on"]["made_worse"]
    assert worse["fit"] == worse["composed"] == []
    assert worse["refined"] == [
        "3/cup: position_mm 10.0 to 40.0",
        "3/cup: size_percent 1.0 to 9.0",
    ]
    assert summary["tuned_on"]["steps"]["answer"]["position_mm"]["median"] == 30.0


def test_unknown_scene_is_refused():
    with pytest.raises(EngineError, match="scenes are 0 to 39"):
        next(photo_rows((40,)))


def test_photos_command_prints_one_json_object(capfd):
    arguments = ["bench", "run", "photos", "--scenes", "8", "--no-search", "--json"]
    with pytest.raises(SystemExit, match="0"):
        cli.main(arguments)
    answer = json.loads(capfd.readouterr().out)
    assert answer["command"] == "neoworld bench run photos --scenes 8 --no-search --json"
    assert answer["tuned_on"]["scenes"] == 1 and "refined" not in answer["tuned_on"]["steps"]

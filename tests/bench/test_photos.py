"""Errors of noisy responses to rendered scenes, step by step."""

import json

import pytest
from neoworld_bench.fidelity.step_errors import (
    PhotoRow,
    PoseError,
    photo_summary,
)

from neoworld_mjx import cli


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


def test_photos_command_prints_one_json_object(capfd):
    arguments = ["bench", "run", "photos", "--scenes", "8", "--no-search", "--json"]
    with pytest.raises(SystemExit, match="0"):
        cli.main(arguments)
    answer = json.loads(capfd.readouterr().out)
    assert answer["command"] == "neoworld bench run photos --scenes 8 --no-search --json"
    assert answer["tuned_on"]["scenes"] == 1 and "refined" not in answer["tuned_on"]["steps"]

"""Scores of reconstructed objects against URDF files in the layout of PartNet-Mobility."""

from pathlib import Path

import pytest
from neoworld_bench.measures.object_scores import (
    object_files,
    object_names,
    score_figures,
    score_object,
)

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import SpecError

QUICK = {"samples": 500, "options": ProgramOptions(type_check=False)}
PROGRAM = """
from neoworld_mjx.program.sdk import Object, box, cylinder
cabinet = Object("cabinet")
body = cabinet.part("body", material="oak")
body.add(box((0.4, 0.5, 0.8)), at=(0, 0, 0.4))
door = cabinet.part("door", material="oak")
door.add(box((0.01, 0.5, 0.4)), at=(0.206, 0, 0.6))
cabinet.revolute("hinge", body, door, at=(0.21, {side}, 0.6), axis={axis}, range=(0, 1.5))
"""
RIGHT = {"side": 0.25, "axis": (0, 0, -1)}
LINK = (
    '<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"'
    ' iyz="0"/></inertial>{1}</link>'
)
SHAPE = '<{0}><origin xyz="{1}"/><geometry><box size="{2}"/></geometry></{0}>'


def link(name, at, size):
    return LINK.format(name, "".join(SHAPE.format(k, at, size) for k in ("visual", "collision")))


@pytest.fixture
def truth(tmp_path) -> Path:
    """A cabinet twice as large as that of PROGRAM, which faces -x, with a door and a drawer."""
    folder = tmp_path / "truth" / "41083"
    folder.mkdir(parents=True)
    links = [
        link("body", "0 0 0", "0.8 1.0 1.6"),
        link("door", "-0.01 0.5 0.4", "0.02 1.0 0.8"),
        link("drawer", "-0.41 0 -0.4", "0.02 1.0 0.6"),
    ]
    joints = (
        '<joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>'
        '<origin xyz="-0.4 -0.5 0"/><axis xyz="0 0 -1"/>'
        '<limit lower="0" upper="1.5" effort="1" velocity="1"/></joint>'
        '<joint name="slide" type="prismatic"><parent link="body"/><child link="drawer"/>'
        '<axis xyz="-1 0 0"/><limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>'
    )
    text = f'<robot name="cabinet">{"".join(links)}{joints}</robot>'
    (folder / "mobility.urdf").write_text(text)
    return tmp_path / "truth"


def scored(tmp_path, truth, program, name="41083", front="-x"):
    made = tmp_path / "made"
    made.mkdir(exist_ok=True)
    (made / f"{name}.py").write_text(program)
    (row,) = score_object("41083", made, truth, front=front, **QUICK)
    return row


def test_reconstructed_objects_are_scored_and_pooled(truth, tmp_path):
    row = scored(tmp_path, truth, PROGRAM.format(**RIGHT))
    # Half the size, and the door alone: its axis and range are right, the drawer is missed.
    assert (row.total, row.predicted, row.hits, row.correct) == (2, 1, 1, 1)
    assert row.axis_deg == pytest.approx(0.0, abs=1e-6) and row.axis_n == 1
    assert row.pivot < 0.02 and row.limits == pytest.approx(1.0)
    assert row.missed == "slide (drawer)" and row.reason == ""
    assert row.scale == pytest.approx(2.0, rel=0.1) and row.f_05 > 80
    figures = score_figures([row, scored(tmp_path, truth, "this is no program")])
    assert (figures["total"], figures["hits"], figures["not_made"]) == (4, 1, 1)
    assert figures["miss"] == figures["type_error"] == 0.75
    assert figures["axis_deg"]["n"] == figures["f_05"]["n"] == 1


def test_the_ground_truth_scores_perfectly(truth):
    (row,) = score_object("41083", truth, truth, front="+x", **QUICK)
    assert (row.hits, row.correct) == (2, 2) and 0 < row.chamfer_x10 < 1.0


def test_errors_of_wrong_paths_name_the_expected_files(truth, tmp_path):
    with pytest.raises(SpecError, match="there is no folder"):
        object_files(tmp_path / "gone")
    (tmp_path / "empty").mkdir()
    with pytest.raises(SpecError, match=r"holds no object: expected is NAME with one of \.py"):
        object_files(tmp_path / "empty")
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "lamp.py").write_text("")
    with pytest.raises(SpecError, match=r"has no object of .*lamp.*41083"):
        object_names(tmp_path / "made", truth)
    with pytest.raises(SpecError, match="object: got '41084'"):
        object_names(tmp_path / "made", truth, ["41084"])

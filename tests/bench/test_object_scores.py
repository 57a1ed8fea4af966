"""Objects in the layout of PartNet-Mobility: their joints, and scores of reconstructed objects."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from neoworld_bench.measures import canonical_points
from neoworld_bench.measures.object_truth import canonical
from neoworld_bench.objects.made_objects import object_files
from neoworld_bench.objects.object_scores import score_figures, score_objects, stored_scores
from neoworld_bench.objects.partnet import partnet_folders, partnet_object
from neoworld_bench.tables.result_tables import write_tables

from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.errors import RunError, SpecError

TURN = f"{math.pi / 2} 0 {-math.pi / 2}"
"""As the data set writes it: from y up and the front at +z to z up and the front at -x."""


def obj(low: tuple, high: tuple) -> str:
    """Return the OBJ text of a box between two corners."""
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    at = lambda c: " ".join(str((low, high)[k][i]) for i, k in enumerate(c))
    faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    lines = ["mtllib gone.mtl", "usemtl gone"] + [f"v {at(c)}" for c in corners]
    return "\n".join(lines + [f"f {' '.join(str(k + 1) for k in face)}" for face in faces])


def write(root: Path, name: str, parts: dict, joints: list, category: str) -> Path:
    """Write an object: boxes by link, in the data set's frame with y up, and its joints."""
    folder = root / name
    (folder / "textured_objs").mkdir(parents=True)
    links, semantics = ['<link name="base"/>'], []
    pivots = {joint["child"]: joint["pivot"] for joint in joints}
    for link, (label, *boxes) in parts.items():
        kind = next((j["type"] for j in joints if j["child"] == link), "fixed")
        semantics.append(f"{link} {kind} {label}")
        off = " ".join(str(-v) for v in pivots[link])
        shapes = ""
        for k, box in enumerate(boxes):
            file = f"textured_objs/{link}-{k}.obj"
            (folder / file).write_text(obj(*box))
            mesh = f'<origin xyz="{off}"/><geometry><mesh filename="{file}"/></geometry>'
            shapes += f'<visual name="{label}-{k}">{mesh}</visual><collision>{mesh}</collision>'
        links.append(f'<link name="{link}">{shapes}</link>')
    for j in joints:
        parent = pivots.get(j["parent"], (0, 0, 0))
        at = " ".join(str(a - b) for a, b in zip(j["pivot"], parent, strict=True))
        turn = f'rpy="{TURN}" ' if j["parent"] == "base" else ""
        limit = '<limit lower="{}" upper="{}"/>'.format(*j["limits"]) if "limits" in j else ""
        links.append(
            f'<joint name="{j["name"]}" type="{j["type"]}"><origin {turn}xyz="{at}"/>'
            f'<axis xyz="{j.get("axis", "1 0 0")}"/><child link="{j["child"]}"/>'
            f'<parent link="{j["parent"]}"/>{limit}</joint>'
        )
    urdf = f'<?xml version="1.0" ?><robot name="partnet_{name}">{"".join(links)}</robot>'
    (folder / "mobility.urdf").write_text(urdf)
    (folder / "meta.json").write_text(json.dumps({"model_cat": category, "anno_id": name}))
    (folder / "semantics.txt").write_text("\n".join(semantics) + "\n")
    return folder


@pytest.fixture(scope="module")
def partnet(tmp_path_factory) -> Path:
    """A cabinet with a door and a drawer that holds a knob, and a tap without limits."""
    root = tmp_path_factory.mktemp("partnet")
    fixed = {"type": "fixed", "parent": "base", "pivot": (0, 0, 0)}
    write(
        root / "dataset",
        "41083",
        {
            "link_2": ("cabinet_body", ((-0.5, -0.8, -0.4), (0.5, 0.8, 0.4))),
            "link_0": ("door", ((-0.5, 0.0, 0.4), (0.5, 0.8, 0.42))),
            "link_1": ("drawer", ((-0.48, -0.7, 0.1), (0.48, -0.1, 0.42))),
            "link_3": ("knob", ((-0.05, -0.45, 0.42), (0.05, -0.35, 0.48))),
        },
        [
            {"name": "joint_2", "child": "link_2", **fixed},
            {"name": "joint_0", "type": "revolute", "parent": "link_2", "child": "link_0",
             "pivot": (0.5, 0.4, 0.42), "axis": "0 1 0", "limits": (-0.0, 1.5)},
            {"name": "joint_1", "type": "prismatic", "parent": "link_2", "child": "link_1",
             "pivot": (0.1, -0.4, 0.2), "axis": "0 0 1", "limits": (0.0, 0.3)},
            {"name": "joint_3", "type": "continuous", "parent": "link_1", "child": "link_3",
             "pivot": (0.0, -0.4, 0.42), "axis": "0 0 1"},
        ],
        "StorageFurniture",
    )  # fmt: skip
    write(
        root / "dataset",
        "1011",
        {
            "link_1": ("spout", ((-0.1, 0.0, -0.1), (0.1, 0.6, 0.5))),
            "link_0": ("switch", ((-0.1, 0.6, -0.1), (0.1, 0.7, 0.3))),
        },
        [
            {"name": "joint_1", "child": "link_1", **fixed},
            {"name": "joint_0", "type": "continuous", "parent": "link_1", "child": "link_0",
             "pivot": (0.0, 0.6, 0.0), "axis": "0 -1 0"},
        ],
        "Fau|cet <b>",
    )  # fmt: skip
    return root


def test_joints_are_read_from_the_urdf(partnet: Path):
    folders = partnet_folders(partnet)
    assert set(folders) == {"41083", "1011"}
    cabinet = partnet_object(folders["41083"], samples=400)
    assert cabinet.category == "StorageFurniture"
    door, drawer, knob = cabinet.truth.joints
    # In the URDF's world x is -z of the meshes, y is -x and z is y.
    assert (door.type, door.child, door.limits) == ("revolute", "door", (0.0, 1.5))
    np.testing.assert_allclose(door.axis, (0, 0, 1), atol=1e-9)
    np.testing.assert_allclose(door.pivot, (-0.42, -0.5, 0.4), atol=1e-9)
    np.testing.assert_allclose(door.moving_box, [(-0.42, -0.5, 0.0), (-0.4, 0.5, 0.8)], atol=1e-9)
    assert (drawer.type, drawer.limits) == ("prismatic", (0.0, 0.3))
    np.testing.assert_allclose(drawer.axis, (-1, 0, 0), atol=1e-9)
    # The knob goes with the drawer.
    np.testing.assert_allclose(drawer.moving_box[0], (-0.48, -0.48, -0.7), atol=1e-9)
    assert (knob.type, knob.limits, knob.parent) == ("continuous", None, "drawer")
    # The front is at +x afterwards, and samples lie in the same frame.
    straight = canonical(cabinet.truth)
    np.testing.assert_allclose(straight.joints[1].axis, (1, 0, 0), atol=1e-9)
    assert cabinet.points is not None and cabinet.points.shape == (400, 3)
    low, high = np.array(straight.box)
    assert (cabinet.points >= low - 1e-9).all() and (cabinet.points <= high + 1e-9).all()
    assert np.ptp(cabinet.points, axis=0) == pytest.approx(high - low, abs=0.05)
    assert canonical_points(np.zeros((1, 3)), cabinet.truth).shape == (1, 3)
    tap = partnet_object(folders["1011"], samples=10)
    assert [(j.type, j.limits) for j in tap.truth.joints] == [("continuous", None)]
    assert tap.category == "Fau_cet__b_"


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


def test_reconstructed_objects_are_scored_and_pooled(partnet: Path, tmp_path: Path):
    made = tmp_path / "made"
    (made / "41083").mkdir(parents=True)
    (made / "41083" / "program.py").write_text(PROGRAM.format(side=0.25, axis=(0, 0, -1)))
    (made / "1011.py").write_text("this is no program")
    rows = {row.object: row for row in score_objects(made, partnet=partnet, out=tmp_path, **QUICK)}
    cabinet, tap = rows["41083"], rows["1011"]
    # Half the size, and the door alone: its line and range are right, drawer and knob are missed.
    assert (cabinet.total, cabinet.predicted, cabinet.hits, cabinet.correct) == (3, 1, 1, 1)
    assert cabinet.axis_deg == pytest.approx(0.0, abs=1e-6) and cabinet.axis_n == 1
    assert cabinet.pivot is not None and cabinet.pivot < 0.02
    assert cabinet.missed == "joint_1 (drawer), joint_3 (knob)" and cabinet.reason == ""
    assert cabinet.f_05 is not None and cabinet.f_05 > 50
    assert (tap.total, tap.hits, tap.f_05) == (1, 0, None) and "1011.py" in tap.reason
    figures = score_figures(list(rows.values()))
    assert (figures["total"], figures["hits"], figures["not_made"]) == (4, 1, 1)
    assert figures["miss"] == figures["type_error"] == 0.75
    assert figures["axis_deg"]["n"] == figures["f_05"]["n"] == 1
    assert {row.object for row in stored_scores(tmp_path)} == {"41083", "1011"}
    # A hinge on the other side is a hit that is not correct.
    (made / "41083" / "program.py").write_text(PROGRAM.format(side=-0.25, axis=(0, 0, 1)))
    (other,) = score_objects(made, partnet=partnet, objects=["41083"], out=tmp_path, **QUICK)
    assert (other.hits, other.correct) == (1, 0)
    assert other.pivot is not None and other.pivot > 0.3
    assert len(stored_scores(tmp_path)) == 2


def test_requested_objects_without_reconstruction_count_as_missed(partnet: Path, tmp_path: Path):
    (tmp_path / "41083.py").write_text(PROGRAM.format(side=0.25, axis=(0, 0, -1)))
    rows = list(score_objects(tmp_path, partnet=partnet, objects=["1011"]))
    assert [(row.reason, row.hits, row.total) for row in rows] == [("not made", 0, 1)]


def test_ground_truth_urdf_scores_perfectly(partnet: Path):
    made = partnet / "dataset"
    (tap,) = score_objects(made, partnet=partnet, objects=["1011"], front="+x", **QUICK)
    assert (tap.hits, tap.correct) == (1, 1) and tap.chamfer_x10 is not None
    assert tap.axis_deg == pytest.approx(0.0, abs=1e-6) and 0 < tap.chamfer_x10 < 1.0


def test_truth_files_give_scores_and_tables_with_the_papers_rows(partnet: Path, tmp_path: Path):
    cabinet = partnet_object(partnet / "dataset" / "41083", samples=200)
    straight = canonical(cabinet.truth)
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "cabinet.json").write_text(straight.model_dump_json())
    np.savez(tmp_path / "truth" / "cabinet.npz", points=cabinet.points)
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "cabinet.py").write_text(PROGRAM.format(side=0.25, axis=(0, 0, -1)))
    out = tmp_path / "out"
    (row,) = score_objects(tmp_path / "made", truth=tmp_path / "truth", out=out, **QUICK)
    assert (row.hits, row.correct, row.scale) == (1, 1, pytest.approx(2.0, rel=0.1))
    write_tables(out)
    text = (out / "joints.md").read_text()
    assert "| cabinet | 3 | 1 | 1 | 1 | 66.67 |" in text and "| all 1 objects | 3 |" in text
    assert "| NeoWorld-Pro* | 245 | 268 | 216 |  | 11.83 | 18.78 |" in text
    assert r"\#Total" in (out / "joints.tex").read_text()
    assert len((out / "joints.csv").read_text().splitlines()) == 1 + 2 + 5
    with pytest.raises(RunError, match="no rows yet"):
        write_tables(tmp_path)


def test_errors_of_wrong_paths_name_the_expected_files(partnet: Path, tmp_path: Path):
    with pytest.raises(
        SpecError, match=r"no folder of PartNet-Mobility.*ID/mobility\.urdf.*OBJ|obj"
    ):
        partnet_folders(tmp_path)
    with pytest.raises(SpecError, match=r"holds no object: expected are NAME\.py"):
        object_files(tmp_path)
    with pytest.raises(SpecError, match="there is no folder"):
        object_files(tmp_path / "gone")
    (tmp_path / "lamp.py").write_text("")
    with pytest.raises(SpecError, match=r"has no object of .*lamp.*1011"):
        next(score_objects(tmp_path, partnet=partnet))
    with pytest.raises(SpecError, match="object: got '41084'"):
        next(score_objects(tmp_path, partnet=partnet, objects=["41084"]))
    with pytest.raises(SpecError, match="name the truth"):
        next(score_objects(tmp_path))
    with pytest.raises(SpecError, match=r"holds no truth: expected NAME\.json"):
        next(score_objects(tmp_path, truth=tmp_path))
    broken = tmp_path / "set" / "7"
    broken.mkdir(parents=True)
    (broken / "mobility.urdf").write_text('<robot name="a"><link name="b"/></robot>')
    with pytest.raises(SpecError, match="has no visible geometry"):
        partnet_object(broken)
    outside = (
        '<link name="b"><visual><geometry><mesh filename="../../x.obj"/></geometry></visual></link>'
    )
    (broken / "mobility.urdf").write_text(f'<robot name="a">{outside}</robot>')
    with pytest.raises(SpecError, match=r"x\.obj"):
        partnet_object(broken)

"""Further photographs in runs: read, kept, marked by a model, and used for the layout."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import neoworld_mjx as nw
from neoworld_mjx.errors import EvidenceError
from neoworld_mjx.evidence.evidence_file import StatedEvidence
from neoworld_mjx.mllm.replay import Tape
from neoworld_mjx.parse.further_boxes import boxes_of_photo, marking_request
from neoworld_mjx.parse.photo import MODEL_MIN_SIDE_PX, load_photo
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.pipeline.further_photos import kept_further, read_further
from neoworld_mjx.spec import SceneTree
from tests.support import answers
from tests.support.scripted_model import ScriptedModel


@pytest.fixture
def folder(tmp_path):
    """Two photographs of one size, one of another shape, and their cameras in nerfstudio's form."""
    for name, size, value in (
        ("a.png", (640, 480), 90), ("b.png", (640, 480), 120), ("c.png", (600, 600), 150)
    ):  # fmt: skip
        Image.new("RGB", size, (value, value, value)).save(tmp_path / name)
    frames = []
    for name, x in (("a.png", 0.0), ("b.png", 2.0)):
        matrix = np.eye(4)
        matrix[0, 3] = x
        frames.append({"file_path": f"images/{name}", "transform_matrix": matrix.tolist()})
    stated = {"fl_x": 600, "cx": 320, "cy": 240, "w": 640, "h": 480, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(stated))
    return tmp_path


def read(folder, **stated):
    stated = StatedEvidence(**stated)
    return read_further(stated, load_photo(folder / "a.png"), None)


def test_a_photograph_without_camera_is_by_the_first_one(folder):
    view = {"photo": str(folder / "b.png"), "boxes": {"cup": (10, 20, 30, 50)}}
    (photo,) = read(folder, views=[view])
    assert photo.focal is None and photo.to_first is None and photo.source == "b.png"
    assert photo.boxes["cup"].as_tuple() == (10, 20, 30, 50)
    assert photo.phrase() == "b.png (the first camera's field of view, unknown pose, 1 boxes)"


@pytest.mark.parametrize(
    ("view", "message"),
    [
        ({"photo": "c.png"}, "c.png, without a camera of its own"),
        ({"photo": "a.png"}, "a.png is the first photograph itself"),
        ({"photo": "b.png", "boxes": {"cup": (30, 0, 10, 5)}}, "box of cup: expected left, top"),
        ({"photo": "b.png", "camera": {"gravity": (0, 1, 0)}}, "states no focal length"),
    ],
)
def test_wrong_photographs_give_one_message(folder, view, message):
    view = view | {"photo": str(folder / view["photo"])}
    with pytest.raises(EvidenceError, match=message):
        read(folder, views=[view])
    with pytest.raises(EvidenceError, match=r"need different names: b\.png"):
        read(folder, views=[{"photo": str(folder / "b.png")}] * 2)


@pytest.mark.anyio
async def test_a_model_marks_the_objects():
    photo, tree = answers.photo(), answers.exact(answers.desk())
    names = [node.name for node in tree.nodes if not node.slab]
    box = {"left": 10, "top": 20, "right": 1e5, "bottom": 60}
    marked = [{"name": name, "box": box} for name in (names[0], "ghost")]
    marked.append({"name": names[1], "box": box | {"right": 5}})
    models = ScriptedModel({"objects": marked})
    further = np.full((300, 400, 3), 90, np.uint8)
    boxes = await boxes_of_photo(photo, tree, further, models, [])
    assert boxes.keys() == {names[0]} and boxes[names[0]].as_tuple() == (10, 20, 400, 60)
    (request,) = models.requests
    assert f"- {names[0]}: " in request.prompt and "400 x 300 pixels" in request.prompt
    assert [picture.label for picture in request.pictures] == ["first", "further"]


def other_photo(photo, file):
    """The photograph with other pixels at its border, as another file."""
    rgb = np.array(load_photo(photo).rgb)
    rgb[:3] = 90
    Image.fromarray(rgb).save(file)
    return file


def test_a_run_asks_for_boxes_once_and_uses_them(tmp_path, photo, quick_config):
    out, tapes = tmp_path / "out", tmp_path / "more.tape.json"
    run = lambda until="compose", **more: reconstruct(photo, out, quick_config, until=until, **more)
    run("program")
    tree = SceneTree.model_validate_json((out / "tree.json").read_text())
    parsed = (out / "parse.json").stat().st_mtime_ns
    further = other_photo(photo, tmp_path / "b.png")
    first, view = (load_photo(file, min_side_px=MODEL_MIN_SIDE_PX) for file in (photo, further))
    tape = Tape.load(Path(nw.__file__).parent / "data" / "tapes" / "coffee.tape.json")
    shown = SceneTree.model_validate_json((out / "tree.json").read_text())
    boxes = [
        {"name": n.name, "box": dict(zip(("left", "top", "right", "bottom"), b, strict=True))}
        for n in tree.nodes
        if not n.slab
        for b in [[view.scale * side for side in n.box2d.as_tuple()]]
    ]
    request = marking_request(first, shown, view.rgb)
    tape.put(request, json.dumps({"objects": boxes}), "test")
    tape.save(tapes)
    run(resume=True, evidence=StatedEvidence(views=[{"photo": str(further)}]), tapes=(tapes,))
    assert (out / "parse.json").stat().st_mtime_ns == parsed
    (kept,) = kept_further(out, marked=True)
    assert len(kept.boxes) == len(boxes) and kept.photo.shape == view.rgb.shape
    used = json.loads((out / "compose" / "align.json").read_text())["views"]["b.png"]
    assert used["objects"] == len(boxes) and used["reason"] == "" and abs(used["turn_deg"]) < 5
    data = json.loads((out / "run.json").read_text())
    assert "b.png (the first camera's" in data["evidence"]["used"]["views"]
    assert "Outlines in a further photograph" in (out / "report.html").read_text()
    with Image.open(out / "pictures" / "view_1.png") as outlines:
        assert outlines.size[0] > 2 * view.size[0]
    assert "b.png is used for the layout" in {note["what"] for note in data["notes"]}
    written = (out / "compose" / "scene.json").stat().st_mtime_ns
    run(resume=True)
    assert (out / "compose" / "scene.json").stat().st_mtime_ns == written
    assert math.isfinite(used["camera"]["height"])

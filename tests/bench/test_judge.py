"""Image comparison and judge on small scenes; the tapes are written by hand."""

import json

import numpy as np
import pytest
from neoworld_bench.judge import picture_rows as comparing
from neoworld_bench.judge.picture_rows import made_scenes, picture_figures, picture_rows
from neoworld_bench.judge.scene_judge import (
    SceneRating,
    judged_pictures,
    rating_figures,
    rating_request,
    rating_rows,
)
from neoworld_bench.measures.picture_similarity import PictureModels
from PIL import Image

from neoworld_mjx import cli
from neoworld_mjx.config import MLLMOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.mllm import Panel
from neoworld_mjx.mllm.replay import Replay, Tape
from neoworld_mjx.mllm.requests import InvalidResponse, read_response
from neoworld_mjx.render import render_scene, to_png
from neoworld_mjx.spec import (
    Box2D,
    Box3D,
    Camera,
    GeomSpec,
    JointSpec,
    Material,
    ObjectSpec,
    PartSpec,
    SceneObject,
    SceneSpec,
    SceneTree,
    TreeNode,
)
from neoworld_mjx.spec.primitives import Box

WIDTH, HEIGHT = 96, 72


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setattr(comparing, "OBJECT_PX", 32)


def geom(name, size, pos, material="wood"):
    return GeomSpec(name=name, shape=Box(size=size), pos=pos, material=material)


def chest(*, hinge=True, color=(0.6, 0.4, 0.2)):
    """A body, optionally with a door on the left of its front."""
    parts = [PartSpec(name="body", geoms=(geom("body", (0.3, 0.4, 0.5), (0.0, 0.0, 0.25)),))]
    joints = []
    if hinge:
        door = geom("door", (0.02, 0.38, 0.25), (0.16, 0.0, 0.35), "pale")
        parts.append(PartSpec(name="door", geoms=(door,)))
        place = {"pos": (0.17, -0.19, 0.35), "axis": (0.0, 0.0, -1.0), "upper": 1.5}
        ends = {"type": "revolute", "parent": "body", "child": "door"}
        joints.append(JointSpec.model_validate({"name": "hinge", **ends, **place}))
    materials = (
        Material(name="wood", density=500.0, rgba=(*color, 1.0)),
        Material(name="pale", density=500.0, rgba=(0.9, 0.85, 0.7, 1.0)),
    )
    return ObjectSpec(name="chest", parts=tuple(parts), joints=tuple(joints), materials=materials)


def scene(spec=None):
    """A chest on the floor, seen from its front."""
    camera = Camera(width=WIDTH, height_px=HEIGHT, fovy=0.8, pitch=0.3, height=0.9)
    item = SceneObject(name="chest", spec=spec or chest(), xy=(1.6, 0.0), yaw=float(np.pi))
    return SceneSpec(name="small", objects=(item,), camera=camera)


@pytest.fixture
def folder(tmp_path):
    """A run folder with what these suites read; the photograph is the scene in other colors."""
    own = tmp_path / "small"
    own.mkdir()
    made, photographed = scene(), scene(chest(color=(0.3, 0.3, 0.5)))
    (own / "scene.json").write_text(made.to_json())
    image = render_scene(photographed)
    (own / "photo.png").write_bytes(to_png(image))
    rows, columns = np.nonzero(image.segmentation == 0)
    box = Box2D(
        x0=float(columns.min()),
        y0=float(rows.min()),
        x1=float(columns.max() + 1),
        y1=float(rows.max() + 1),
    )
    room = Box3D(position=(1.6, 0.0, 0.25), size=(0.3, 0.4, 0.5), yaw=0.0)
    floor = TreeNode(
        name="floor",
        label="floor",
        environment=True,
        box2d=Box2D(x0=0.0, y0=20.0, x1=96.0, y1=72.0),
        box3d=Box3D(position=(1.6, 0.0, -0.05), size=(3.0, 3.0, 0.1), yaw=0.0),
    )
    node = TreeNode(name="chest", label="chest", parent="floor", box2d=box, box3d=room)
    tree = SceneTree(camera=made.camera, nodes=(floor, node))
    (own / "tree.json").write_text(tree.to_json())
    return own


def compared(folder):
    return list(picture_rows(made_scenes([folder])[0], PictureModels(), side=96))


def test_scene_and_objects_are_compared_with_the_photograph(folder):
    rows = compared(folder)
    assert [row.object for row in rows] == ["", "chest"]
    assert (rows[0].width, rows[0].height, rows[1].width) == (96, 72, 32)
    assert all(0 < row.ssim < 1 and row.clip is None for row in rows)
    figures = picture_figures(rows)
    assert figures["scenes"]["ssim"] == {"value": rows[0].ssim, "n": 1}
    assert figures["objects"]["uni3d"] == {"value": None, "n": 0}
    assert figures["paper"]["scenes"]["full"]["NeoWorld-Pro"] == {"clip": 0.9128, "dino": 0.7855}


def test_a_submission_takes_photograph_camera_and_boxes_from_the_data_set(folder, tmp_path):
    truth = tmp_path / "data" / "scenes" / "small"
    truth.mkdir(parents=True)
    for name in ("photo.png", "tree.json"):
        (folder / name).rename(truth / name)
    (folder / "scene.json").unlink()
    bodies = (
        '<body name="chest" pos="1.6 0 0.25"><freejoint/>'
        '<geom type="box" size="0.15 0.2 0.25"/></body>'
        '<body name="floor"><geom type="box" size="2 2 0.1" pos="1 0 -0.1"/></body>'
    )
    (folder / "scene.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    (made,) = made_scenes([folder.parent / "small"], tmp_path / "data")
    assert set(made.boxes) == {"chest"} and made.camera == scene().camera
    photo, rendered = made.whole(96)
    assert photo.shape == rendered.shape == (72, 96, 3)
    with pytest.raises(SpecError, match="--data names the data set"):
        made_scenes([folder])
    with pytest.raises(SpecError, match=r"nor has .*none.*expected is photo\.png"):
        made_scenes([folder], tmp_path / "none")


def _no_scene(folder):
    (folder / "scene.json").unlink()


def _no_photo(folder):
    (folder / "photo.png").unlink()


def _other_aspect(folder):
    Image.new("RGB", (96, 96)).save(folder / "photo.png")


def _no_camera(folder):
    text = scene().model_copy(update={"camera": None}).to_json()
    (folder / "scene.json").write_text(text)
    (folder / "tree.json").unlink()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_no_scene, r"has no scene: expected is one of scene\.json, scene\.xml"),
        (_no_photo, r"has no photograph: expected is photo\.png or picture\.png"),
        (_other_aspect, "96 x 96 pixels and the scene's camera 96 x 72"),
        (_no_camera, "has no camera"),
    ],
)
def test_errors_of_invalid_folders_name_the_cause(folder, spoil, message):
    spoil(folder)
    with pytest.raises(SpecError, match=message):
        made_scenes([folder])


def test_commands_report_missing_arguments(capfd, folder):
    for arguments, message in (
        (["pictures"], "name at least one run folder"),
        (["pictures", str(folder), "--size", "8"], "--size takes 64 to 4096 pixels, got 8"),
        (["pictures", str(folder), "--clip", str(folder)], "preprocessor_config.json"),
        (["judge", str(folder), "--provider", "mailbox"], "mailbox"),
    ):
        with pytest.raises(SystemExit) as ended:
            cli.main(["bench", "run", *arguments])
        assert ended.value.code == 2
        assert message in capfd.readouterr().err


def rating(*scores):
    questions = ("completeness", "layout", "function")
    return {q: {"reason": "by hand", "score": s} for q, s in zip(questions, scores, strict=True)}


def judged(folder, answers):
    """Return the rows of a tape written by hand; an answer may be any text."""
    (made,) = made_scenes([folder])
    tape = Tape(made="written by hand")
    pictures = judged_pictures(made)
    for k, answer in enumerate(answers, start=1):
        text = answer if isinstance(answer, str) else json.dumps(answer)
        tape.put(rating_request(made, pictures, k, len(answers)), text, "hand")
    with Panel(Replay(tape, "by hand"), MLLMOptions()) as models:
        return list(rating_rows(models, [made], repeats=len(answers)))


def test_invalid_ratings_count_as_missing(folder):
    answers = [rating(6, 5, 4), rating(7, 5, 2), rating(9, 5, 5), "I would rather not."]
    rows = judged(folder, answers)
    assert [row.completeness for row in rows] == [6, 7, None, None]
    assert "score" in rows[2].why and rows[3].why
    figures = rating_figures(rows)
    assert (figures["scenes"], figures["answers"], figures["missing"]) == (1, 2, 2)
    assert (figures["n"], figures["completeness"], figures["function"]) == (1, 6.5, 3)
    assert figures["sd_repeats"]["function"] == pytest.approx(np.std([4, 2], ddof=1))
    assert figures["sd_scenes"]["function"] is None
    more = [*rows, rows[0].model_copy(update={"scene_number": 1})]
    # Scenes count alike, however many answers they have.
    assert rating_figures(more)["completeness"] == (6.5 + 6) / 2
    assert rating_figures(more)["sd_scenes"]["completeness"] == pytest.approx(np.sqrt(0.125))


@pytest.mark.parametrize("score", [0, 8, 3.5, "7", True, None])
def test_scores_are_integers_from_one_to_seven(score):
    with pytest.raises(InvalidResponse, match="score"):
        read_response(json.dumps(rating(score, 5, 5)), SceneRating)


def test_judge_requests_list_joints_and_differ_only_by_repeat(folder):
    (made,) = made_scenes([folder])
    pictures = judged_pictures(made)
    first, second = (rating_request(made, pictures, k, 2) for k in (1, 2))
    assert "- chest: door (revolute)" in first.prompt and first.key != second.key
    differing = {part for part in first.parts if first.parts[part] != second.parts[part]}
    assert differing == {"prompt"}
    assert [p.label for p in first.pictures] == ["photo", "scene", "aside", "open"]
    still = made_scenes([folder])[0]
    plain = {"scene": scene(chest(hinge=False))}
    still = type(made)(**(made.__dict__ | plain))
    assert [p.label for p in judged_pictures(still)][-1] == "aside"
    assert "- none" in rating_request(still, pictures, 1, 1).prompt

"""Evidence in runs: kept, noticed by --resume, applied to photograph and parse, and base frames."""

import asyncio
import copy
import dataclasses
import json
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

import neoworld_mjx as nw
from neoworld_mjx.config import ParseOptions
from neoworld_mjx.errors import EvidenceError, RunError
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.evidence_file import StatedEvidence
from neoworld_mjx.evidence.masks import Masks
from neoworld_mjx.evidence.stored import evidence_files, evidence_lines, read_stored
from neoworld_mjx.mllm.replay import Tape
from neoworld_mjx.parse.parse import parse
from neoworld_mjx.parse.photo import MODEL_MIN_SIDE_PX, load_photo
from neoworld_mjx.parse.prompts import parse_request
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.pipeline.annotated import write_annotated
from neoworld_mjx.pipeline.given_evidence import evidence_of_run
from neoworld_mjx.render.rasterize import draw_scene
from neoworld_mjx.spec import read_scene, world_poses
from tests.support import answers
from tests.support.annotations import FOVY_DEG, HEIGHT_M, PITCH_DEG, coffee
from tests.support.made_up_view import HEIGHT, WIDTH, depth, labels, picture
from tests.support.scripted_model import ScriptedModel

SIZE = (600, 400)
FOCAL = 200 / math.tan(math.radians(FOVY_DEG) / 2)
CALIBRATED = nw.KnownCamera(
    SIZE,
    focal=FOCAL,
    pitch=math.radians(PITCH_DEG),
    roll=0.0,
    height=HEIGHT_M,
    base=(0.5, -0.2, 0.4),
    heading=2.0,
    source="calibration",
)


def write_example(folder):
    """Write a photograph, its evidence and the file that names it."""
    Image.fromarray(picture()).save(folder / "photo.png")
    files = folder / "files"
    files.mkdir()
    np.save(files / "depth.npy", depth())
    Image.fromarray(labels()).save(files / "masks.png")
    (files / "names.json").write_text('{"red": 3}')
    lens = {"fx": 300, "fy": 300, "cx": 159.5, "cy": 119.5}
    (files / "camera.json").write_text(json.dumps(lens))
    (folder / "evidence.yaml").write_text(
        "camera: files/camera.json\n"
        "gravity: [0.0, 0.8, 0.6]\n"
        "depth: {file: files/depth.npy, error: 0.02}\n"
        "masks: {file: files/masks.png, names: files/names.json}\n"
    )
    return folder / "evidence.yaml"


def tape_with(folder, photo, *depths):
    """Write the bundled tape, with its parse also as the response to requests that show depths."""
    tape = Tape.load(Path(nw.__file__).parent / "data" / "tapes" / "coffee.tape.json")
    picture = load_photo(photo, min_side_px=MODEL_MIN_SIDE_PX)
    parsed = next(entry for entry in tape.answers.values() if entry.name == "parse")
    for values in depths:
        request = parse_request(picture, Evidence(depth=values))
        tape.answers[request.key] = parsed
    tape.save(folder / "depths.tape.json")
    return (folder / "depths.tape.json",)


def test_one_file_names_all_evidence(tmp_path):
    read = nw.read_evidence(write_example(tmp_path), tmp_path / "photo.png")
    assert (
        read.camera.focal == pytest.approx(300) and read.camera.source == "camera.json and gravity"
    )
    assert read.camera.pitch == pytest.approx(math.asin(0.6)) and read.camera.base is None
    assert read.depth.smooth_sd == 0.02 and read.masks.names == {"red": 3}
    assert isinstance(read, nw.Evidence)


def test_flags_take_precedence_over_the_file(tmp_path, monkeypatch):
    from neoworld_mjx.commands.base_command import EvidenceFlags

    file = write_example(tmp_path)
    stated = EvidenceFlags(evidence=file, gravity=(0.0, 1.0, 0.0)).stated()
    assert stated.gravity == (0, 1, 0) and stated.camera == str(tmp_path / "files/camera.json")
    assert EvidenceFlags().stated() is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("depht: a.png", "unknown key depht"),
        ("depth: {file: a.png, kind: relative}", "kind"),
        ("camera: no.json", "cannot read camera .*no.json"),
        ("ground: 0.1", "give the pose of the camera by base"),
        ("depth: {file: files/depth.npy, camera: files/camera.json}", "both camera and to_photo"),
        ("base: files/camera.json", "states no pose: give the 4 x 4 transform"),
        ("[1, 2]", "no evidence file"),
    ],
)
def test_wrong_files_give_one_message(tmp_path, text, message):
    file = write_example(tmp_path)
    file.write_text(text)
    with pytest.raises(EvidenceError, match=message):
        nw.read_evidence(file, tmp_path / "photo.png")


def test_stored_evidence_is_read_back(tmp_path):
    given = nw.read_evidence(write_example(tmp_path), tmp_path / "photo.png")
    trust = np.full((HEIGHT, WIDTH), 0.5)
    given = dataclasses.replace(given, depth=dataclasses.replace(given.depth, confidence=trust))
    for name, data in evidence_files(given).items():
        (tmp_path / name).write_bytes(data)
    read = read_stored(tmp_path)
    assert read.camera == given.camera and read.lens is None
    assert np.allclose(read.depth.values, given.depth.values, atol=1e-6, equal_nan=True)
    assert (read.depth.confidence == 0.5).all() and read.depth.source == "depth.npy"
    assert (read.masks.of("red") == given.masks.of("red")).all()
    (tmp_path / "evidence.json").write_text('{"camera": {"focal": 3}}')
    with pytest.raises(EvidenceError, match=r"evidence\.json is damaged.*give the evidence again"):
        read_stored(tmp_path)


def test_runs_keep_their_evidence_and_notice_changes(tmp_path, photo, quick_config):
    out = tmp_path / "out"
    values = np.linspace(0.3, 0.5, 400)[:, None] + np.zeros((1, 600))
    image = nw.DepthImage(values, source="sensor.png")
    other = nw.DepthImage(values + 0.01, source="sensor.png")
    tapes = tape_with(tmp_path, photo, image, other)
    run = lambda **kwargs: reconstruct(
        photo, out, quick_config, until="parse", tapes=tapes, **kwargs
    )
    written = lambda: (out / "tree.json").stat().st_mtime_ns
    run(evidence=nw.Evidence(depth=image))
    data = json.loads((out / "run.json").read_text())
    assert "metric, 100% of 600 x 400 pixels" in data["evidence"]["used"]["depth"]
    assert {"evidence/depth.npy", "evidence/evidence.json"} <= set(
        data["steps"]["parse/evidence"]["outputs"]
    )
    first = written()
    run(evidence=nw.Evidence(depth=image), resume=True)
    run(resume=True)  # The run's own evidence.
    assert written() == first and (out / "evidence" / "depth.npy").is_file()
    run(start="parse")
    assert (out / "evidence" / "depth.npy").is_file()
    second = written()
    run(evidence=nw.Evidence(depth=other), resume=True)
    assert written() != second
    assert np.allclose(read_stored(out / "evidence").depth.values, other.values)
    with pytest.raises(RunError, match="give new evidence with --resume"):
        reconstruct(photo, out, quick_config, start="compose", evidence=nw.Evidence(depth=image))
    run(overwrite=True)
    assert not (out / "evidence").exists()
    assert json.loads((out / "run.json").read_text())["evidence"] == {"used": {}, "refused": []}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (nw.Evidence(camera=nw.KnownCamera((640, 480), focal=600.0)), "known camera has 640 x 480"),
        (nw.Evidence(depth=nw.DepthImage(np.ones((30, 60)))), "depth image has 60 x 30"),
        (nw.Evidence(depth=nw.DepthImage(np.full((40, 60), 900.0))), "give scale: 0.001"),
        (nw.Evidence(masks=nw.Masks(np.zeros((40, 60), np.int32))), "has no masks"),
    ],
)
def test_evidence_from_python_is_checked(photo, given, message):
    with pytest.raises(EvidenceError, match=message):
        evidence_of_run(load_photo(photo), given)


def test_evidence_of_a_run_is_not_read_through_links(tmp_path, photo):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "evidence").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RunError, match="is a link"):
        evidence_of_run(load_photo(photo), None, tmp_path / "out")


def test_depth_in_another_unit_than_the_response_is_refused(tmp_path, photo, quick_config):
    values = np.linspace(3.0, 5.0, 400)[:, None] + np.zeros((1, 600))
    given = nw.Evidence(depth=nw.DepthImage(values, source="depth.png"))
    tapes = tape_with(tmp_path, photo, given.depth)
    run = lambda: reconstruct(
        photo, tmp_path / "out", quick_config, until="parse", evidence=given, tapes=tapes
    )
    with pytest.raises(EvidenceError, match=r"depth\.png: its depths are .* times the distances"):
        run()


def jpeg(path, mm=26, size=(640, 480), taken=None):
    exif = Image.Exif()
    ifd = exif.get_ifd(0x8769)
    ifd[0xA405] = mm
    if taken is not None:
        ifd[0xA002], ifd[0xA003] = taken
    Image.new("RGB", size, "gray").save(path, exif=exif)
    return load_photo(path)


def test_focal_length_of_exif_is_a_prior(tmp_path):
    known = evidence_of_run(jpeg(tmp_path / "a.jpg"), None).evidence.camera
    assert known.focal == pytest.approx(26 * 800 / math.hypot(36, 24)) and known.focal_sd == 0.03
    assert known.source == "EXIF of a.jpg (26 mm)"
    gravity = StatedEvidence(gravity=(0, 1, 0))
    both = evidence_of_run(load_photo(tmp_path / "a.jpg"), gravity).evidence.camera
    assert both.focal_sd == 0.03 and both.pitch == pytest.approx(0)
    assert both.source_of("focal") == "EXIF of a.jpg (26 mm)" != both.source_of("pitch")
    assert "gravity; EXIF of a.jpg" in evidence_lines(nw.Evidence(camera=both))["camera"]
    calibrated = nw.Evidence(camera=nw.KnownCamera((640, 480), focal=600.0))
    read = evidence_of_run(load_photo(tmp_path / "a.jpg"), calibrated)
    assert read.evidence is calibrated and "0.80 times that of" in read.refused[0]


def test_known_camera_is_told_to_the_model_and_replaces_its_answer():
    data = copy.deepcopy(answers.desk())
    photo = answers.photo()
    camera = answers.exact(data).camera
    known = nw.KnownCamera(
        (camera.width, camera.height_px), focal=1.3 * camera.focal, pitch=camera.pitch + 0.1
    )
    models = ScriptedModel(data)
    options = ParseOptions(critic_rounds=0)
    parsed = asyncio.run(parse(photo, models, options, Evidence(camera=known)))
    prompt = models.requests[0].prompt
    fovy = math.degrees(2 * math.atan(camera.height_px / 2 / known.focal))
    assert f"fovy_deg {fovy:.2f}, pitch_deg {math.degrees(known.pitch):.2f}." in prompt
    assert "height" not in prompt.split("The camera was measured")[1].split(".")[0]
    after = parsed.tree.camera
    assert after.focal == pytest.approx(known.focal) and after.pitch == known.pitch
    before = answers.exact(data)
    for node in parsed.tree.nodes:
        if not node.environment:
            old, _ = before.camera.project(before.node(node.name).box3d.position)
            new, _ = after.project(node.box3d.position)
            assert np.allclose(old, new, atol=1.0)


def test_photograph_of_a_lens_with_distortion_is_undistorted_once(tmp_path, photo, quick_config):
    lens = {"fx": 900, "fy": 900, "cx": 299.5, "cy": 199.5}
    lens["distortion"] = {"coefficients": [-0.4, 0.1]}
    stated = StatedEvidence(camera=lens)
    out = tmp_path / "out"
    annotation = coffee()
    write_annotated(photo, out, annotation, quick_config, simulate=False, evidence=stated)
    shown, taken = (load_photo(file).rgb for file in (out / "photo.png", photo))
    assert shown.shape == taken.shape and np.abs(shown.astype(int) - taken).mean() > 1
    tree = json.loads((out / "tree.json").read_text())
    stored = read_stored(out / "evidence")
    assert stored.lens is not None
    focal = 200 / math.tan(tree["camera"]["fovy"] / 2)
    assert focal == pytest.approx(stored.camera.focal)
    before = (out / "photo.png").read_bytes()
    reconstruct(photo, out, quick_config, resume=True, until="program")
    assert (out / "photo.png").read_bytes() == before


@pytest.fixture(scope="module")
def both_frames(tmp_path_factory, photo, quick_config):
    """Runs of one annotation: in the frame below the camera, and in a robot's base frame."""
    folder = tmp_path_factory.mktemp("frames")
    own = dataclasses.replace(CALIBRATED, base=None, heading=0.0)
    for name, camera in {"camera": own, "base": CALIBRATED}.items():
        given = nw.Evidence(camera=camera)
        write_annotated(photo, folder / name, coffee(), quick_config, evidence=given)
    return folder / "camera", folder / "base"


def test_scene_is_expressed_in_the_base_frame(both_frames):
    own, base = (read_scene(folder / "compose" / "scene.json") for folder in both_frames)
    frame = CALIBRATED.base_frame(own.camera)
    assert np.allclose(base.camera.position(), frame.apply(own.camera.position()))
    assert np.allclose(base.camera.position()[:2], CALIBRATED.base[:2])
    for name, at in world_poses(own).items():
        moved = frame.then(at)
        assert np.allclose(world_poses(base)[name].pos, moved.pos, atol=1e-9)
        assert abs(world_poses(base)[name].quat @ moved.quat) == pytest.approx(1)
    assert base.backdrop is None


def test_refined_scene_and_exports_are_in_the_base_frame(both_frames):
    """The search and the final check give the same scene in either frame."""
    own, base = (read_scene(folder) for folder in both_frames)
    frame = CALIBRATED.base_frame(own.camera)
    model = mujoco.MjModel.from_xml_path(str(both_frames[1] / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.opt.gravity.tolist() == [0, 0, -9.81]
    for name, at in world_poses(own).items():
        expected = frame.apply(at.pos)
        assert np.linalg.norm(world_poses(base)[name].pos - expected) < 0.002
        assert np.linalg.norm(data.body(name).xpos - expected) < 0.002
    camera = data.camera("photo")
    assert np.allclose(camera.xpos[:2], CALIBRATED.base[:2], atol=1e-6)
    ahead = -camera.xmat.reshape(3, 3)[:, 2]
    assert math.atan2(ahead[1], ahead[0]) == pytest.approx(2.0, abs=1e-3)


def test_run_shows_what_the_evidence_says(both_frames, tmp_path, photo, quick_config):
    scene = read_scene(both_frames[0] / "compose" / "scene.json")
    drawn = draw_scene(scene, scene.camera, SIZE[0])
    values = np.where(np.isfinite(drawn.depth), drawn.depth, np.nan)
    cup = scene.index("cup")
    given = nw.Evidence(
        camera=dataclasses.replace(CALIBRATED, base=None, heading=0.0),
        depth=nw.DepthImage(values),
        masks=Masks((drawn.owner == cup).astype(int), {"cup": 1}),
    )
    write_annotated(photo, tmp_path / "out", coffee(), quick_config, evidence=given)
    aligned = json.loads((tmp_path / "out" / "compose" / "align.json").read_text())
    assert {entry["source"] for entry in aligned["camera"].values()} == {"calibration"}
    assert aligned["masks_iou"]["cup"]["aligned"] > 0.8
    picture = np.asarray(Image.open(tmp_path / "out" / "pictures" / "depth.png")).astype(int)
    on_cup = picture[:-30][np.asarray(Image.fromarray(drawn.owner == cup).resize((640, 427)))]
    assert np.median(on_cup.max(axis=1)) > 200  # Not gray: its depth is measured.
    page = (tmp_path / "out" / "report.html").read_text()
    assert "calibration</td>" in page and "Rendered minus measured distance" in page
    # The final alignment uses the photograph and the evidence; if they change, Step 5 is repeated.
    steps = json.loads((tmp_path / "out" / "run.json").read_text())["steps"]
    assert {"photo", "align", "evidence", "scene"} <= steps["refine"]["inputs"].keys()

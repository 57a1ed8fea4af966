"""Rescue of posed meshes: supports, resting poses, and the command."""

import json
import shutil

import numpy as np
import pytest
import trimesh
from neoworld_bench.rescues.rescue_rows import (
    CAMERA,
    TABLE_Z,
    camera_file,
    disturbed,
    photograph_of,
    scene_of_meshes,
    standing,
    upright,
)
from PIL import Image

from neoworld_mjx import cli
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import EvidenceError, PhotoError, RunError, SpecError
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.evidence_file import StatedEvidence
from neoworld_mjx.export.importing import import_file
from neoworld_mjx.export.write_glb import glb_bytes
from neoworld_mjx.io.files import content_hash
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.pipeline.mesh_tree import doubt_solids, doubt_unit, mesh_tree, scaled_scene
from neoworld_mjx.pipeline.place import place
from neoworld_mjx.pipeline.rescue import photo_evidence, posed_tree, rescue_file
from neoworld_mjx.render import render_scene, visible_surface
from neoworld_mjx.spec import SceneSpec, bounds, read_scene, world_poses
from neoworld_mjx.spec.pose import from_yaw, matrix, pose
from tests.support.bop_sample import desk
from tests.support.mesh_scenes import write_glb, write_poses


def without(scene: SceneSpec, name: str) -> SceneSpec:
    objects = tuple(
        o.model_copy(update={"parent": None, "z": o.z + 0.04}) if o.parent == name else o
        for o in scene.objects
        if o.name != name
    )
    return scene.model_copy(update={"objects": objects})


def lowest(scene: SceneSpec, name: str) -> float:
    """Return the height of the lowest point of an object's surface [m]."""
    vertices, _ = visible_surface(scene.object(name).spec)
    return float(world_poses(scene)[name].apply(vertices)[:, 2].min())


def placed(scene: SceneSpec) -> SceneSpec:
    """Return posed meshes on their supports, as a rescue without a photograph composes them."""
    meshes = mesh_tree(scene)
    return place(meshes.tree, meshes.objects, Evidence(boxes=False)).scene


def test_supports_are_what_carries():
    """A carton carries a smaller one, and the table both; nothing says what a support is."""
    objects = standing(4)
    supported = placed(scene_of_meshes(objects).spec)
    parents = {item.name: item.parent for item in supported.objects}
    assert supported.camera is None
    assert parents.pop("table") is None and parents.pop("upper_1") == "carton_1"
    assert set(parents.values()) == {"table"}
    assert [item.name for item in supported.objects if item.environment] == ["table"]
    for name, at in world_poses(scene_of_meshes(objects).spec).items():
        assert world_poses(supported)[name].pos == pytest.approx(at.pos, abs=5e-4)


def test_sunk_objects_are_lifted_onto_their_support(disturbed_meshes):
    meshes = mesh_tree(disturbed_meshes)
    result = place(meshes.tree, meshes.objects, Evidence(boxes=False))
    for item in result.scene.objects[1:]:
        assert item.parent == "table" and item.box2d is None
        assert lowest(result.scene, item.name) == pytest.approx(TABLE_Z, abs=1e-3)
    notes = result.composed.notes
    assert sum("tilted it by 5.0 deg to its resting pose" in note for note in notes) == 5


def test_objects_without_a_support_get_a_floor():
    scene = without(desk(), "table")
    given = scene.model_copy(
        update={"objects": tuple(o.model_copy(update={"parent": None}) for o in scene.objects)}
    )
    supported, notes = placed(given), mesh_tree(given).notes
    floor = supported.objects[0]
    assert floor.name == "floor" and floor.environment
    assert {item.parent for item in supported.objects[1:]} == {"floor"}
    assert world_poses(supported)["can"].pos[2] == pytest.approx(0.08, abs=5e-4)
    assert any("floor is added below what nothing carries: block" in n for n in notes)


def test_what_states_its_supports_is_refused():
    with pytest.raises(SpecError, match="already states its supports"):
        mesh_tree(desk())
    fixed = desk().objects[0]
    with pytest.raises(SpecError, match="free to move"):
        mesh_tree(SceneSpec(objects=(fixed,)))


def test_command_writes_a_scene_that_passes(tmp_path, capfd):
    write_poses(tmp_path / "given", desk())
    content = json.loads((tmp_path / "given" / "poses.json").read_text())
    for name in ("block", "can"):
        content["objects"][name]["pose"][2][3] -= 0.02
    (tmp_path / "given" / "poses.json").write_text(json.dumps(content))
    command = ["refine", str(tmp_path / "out"), "--from", str(tmp_path / "given" / "poses.json")]
    with pytest.raises(SystemExit, match="0"):
        cli.main([*command, "--json"])
    result = json.loads(capfd.readouterr().out)
    assert result["passed"] and result["box_iou"] is None
    assert any("no colliders" in note["what"] for note in result["notes"])
    given, stored = read_scene(tmp_path / "out" / "given.json"), read_scene(tmp_path / "out")
    rise = lambda name: world_poses(stored)[name].pos[2] - world_poses(given)[name].pos[2]
    assert rise("block") == pytest.approx(0.02, abs=1e-3)
    assert passes(measured(stored, RefineOptions()), RefineOptions())
    for file in ("scene.xml", "scene.usda", "report.html"):
        assert (tmp_path / "out" / file).is_file()
    with pytest.raises(RunError, match="not empty"):
        rescue_file(tmp_path / "given" / "poses.json", tmp_path / "out")


@pytest.fixture(scope="module")
def disturbed_meshes():
    return scene_of_meshes(disturbed(standing(2), 2)).spec


@pytest.fixture(scope="module")
def photograph(tmp_path_factory):
    """The photograph of the undisturbed meshes."""
    file = tmp_path_factory.mktemp("photograph") / "photo.png"
    Image.fromarray(photograph_of(scene_of_meshes(standing(2)).spec)).save(file)
    return file


@pytest.fixture
def photographed_meshes(photograph, disturbed_meshes, tmp_path):
    """A poses.json of disturbed meshes, the photograph of the undisturbed ones, and its camera."""
    shutil.copy(photograph, tmp_path)
    (tmp_path / "camera.json").write_text(camera_file().model_dump_json(exclude_none=True))
    return write_poses(tmp_path / "given", disturbed_meshes)


def with_camera(file, given):
    """Write the disturbed meshes as glTF with the camera of their photograph."""
    return write_glb(file, given, camera=(CAMERA, pose((0, 0, 0))))


def test_camera_of_gltf_is_that_of_its_file_and_yields_to_the_users(
    photographed_meshes, disturbed_meshes, tmp_path
):
    photo = tmp_path / "photo.png"
    read = import_file(with_camera(tmp_path / "a.glb", disturbed_meshes))
    given = StatedEvidence(camera=str(tmp_path / "camera.json"))
    for pair in ((StatedEvidence(), read.camera), (given, None)):
        _, known = photo_evidence(photo, *pair)
        top = posed_tree(read, known.camera).tree.camera
        assert top.model_dump() == pytest.approx(
            CAMERA.model_copy(update={"height": CAMERA.height - TABLE_Z}).model_dump(), abs=1e-6
        )
    _, wide = photo_evidence(photo, StatedEvidence(camera={"fovy": 1.2}), read.camera)
    assert wide.camera.camera(CAMERA).fovy == pytest.approx(1.2)
    assert wide.camera.pitch == pytest.approx(CAMERA.pitch)


def test_report_of_a_rescue_says_what_was_checked(
    photographed_meshes, disturbed_meshes, tmp_path, capfd
):
    file = with_camera(tmp_path / "scene.glb", disturbed_meshes)
    command = ["refine", str(tmp_path / "out"), "--from", str(file)]
    command += ["--photo", str(tmp_path / "photo.png")]
    with pytest.raises(SystemExit, match="0"):
        cli.main(command)
    printed = capfd.readouterr().out
    assert f"report: {tmp_path / 'out' / 'report.html'}" in printed
    report = (tmp_path / "out" / "report.html").read_text()
    assert "6 of 6 were not tested alone" in report and "pass the object tests" not in report
    assert report.count("from the given pose") == 5
    assert "Changes from the composed to the aligned scene" in report
    result = json.loads((tmp_path / "out" / "run.json").read_text())
    notes = [note["what"] for note in result["notes"]]
    assert "the camera of the photograph is taken from scene.glb" in notes
    aligned = json.loads((tmp_path / "out" / "compose" / "align.json").read_text())
    pairs = aligned["outlines_px"].values()
    assert len(pairs) == 5 and all(pair["aligned"] < pair["composed"] for pair in pairs)
    assert read_scene(tmp_path / "out").camera is not None
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    for step in run["steps"].values():  # Nothing that a step wrote was changed afterwards.
        for file, digest in step["outputs"].items():
            assert content_hash(tmp_path / "out" / file) == digest, file


@pytest.mark.parametrize("base", [False, True])
def test_scene_of_a_robot_stays_in_its_base_frame(tmp_path, base):
    """With `base`, poses of the file and of the result are in one frame."""
    scene = desk()
    Image.fromarray(render_scene(scene, width=480).color).save(tmp_path / "photo.png")
    frame = pose((0.3, -0.2, 0.1), from_yaw(2.0))
    into = np.eye(4)
    into[:3, :3], into[:3, 3] = matrix(frame.quat), frame.pos
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = scene.camera.axes(), scene.camera.position()
    lens = scene.camera.resized(480, 360)
    k = [[lens.focal, 0, 239.5], [0, lens.focal, 179.5], [0, 0, 1]]
    np.save(tmp_path / "K.npy", k)
    np.save(tmp_path / "pose.npy", into @ camera)
    stated = {"camera": str(tmp_path / "K.npy"), "base": str(tmp_path / "pose.npy")}
    if not base:
        file = {"fx": k[0][0], "fy": k[1][1], "cx": 239.5, "cy": 179.5}
        (tmp_path / "camera.json").write_text(json.dumps(file | {"pose": (into @ camera).tolist()}))
        stated = {"camera": str(tmp_path / "camera.json")}
    file = write_poses(tmp_path / "given", scene, into=into)
    rescue_file(
        *(file, tmp_path / "out"), photo=tmp_path / "photo.png", evidence=StatedEvidence(**stated)
    )
    result, given = read_scene(tmp_path / "out"), read_scene(tmp_path / "out" / "given.json")
    poses, expected = world_poses(result), world_poses(scene)
    for name in ("block", "carton", "can"):
        # Otherwise the camera is above the origin, and z = 0 is the top of the table.
        at = frame.apply(expected[name].pos) if base else expected[name].pos - [0, 0, 0.04]
        assert poses[name].pos == pytest.approx(at, abs=5e-3)
        assert world_poses(given)[name].pos == pytest.approx(at, abs=1e-6)
    assert np.allclose(result.camera.xy, (into @ camera)[:2, 3] if base else 0, atol=1e-6)


@pytest.mark.parametrize(
    ("camera", "photo", "message"),
    [
        (None, True, "states no camera: give it by --camera FILE.json"),
        ({"fovy": 0.7}, True, "has no pose: give it by --camera"),
        ({"fovy": 7.0}, True, "fovy"),
        ({"fovy": 0.7}, False, "give it by --photo"),
    ],
)
def test_wrong_cameras_of_a_photograph_give_one_message(
    photographed_meshes, tmp_path, camera, photo, message
):
    file = tmp_path / "camera.json"
    if camera is not None:
        file.write_text(json.dumps(camera))
    with pytest.raises((EvidenceError, PhotoError, SpecError), match=message):
        rescue_file(
            photographed_meshes,
            tmp_path / "out",
            photo=tmp_path / "photo.png" if photo else None,
            evidence=None if camera is None else StatedEvidence(camera=str(file)),
        )
    assert not (tmp_path / "out").exists()


def boxes(**extents_at):
    """Return an imported scene of boxes, each given by its extents and its center [m]."""
    return scene_of_meshes(
        {
            name: (trimesh.creation.box(extents), upright(np.array(at), 0))
            for name, (extents, at) in extents_at.items()
        }
    )


def test_a_scene_in_another_unit_is_doubted_and_can_be_scaled(tmp_path):
    given = boxes(table=((80, 80, 4), (0, 0, -2)), box=((10, 10, 10), (5, 0, 5)))
    with pytest.raises(SpecError, match=r"box 10 m\): is it in centimeters\? .*--scale 0\.01; "):
        doubt_unit(given.spec)
    small = scaled_scene(given, 0.01)
    doubt_unit(small.spec)
    assert world_poses(small.spec)["box"].pos == pytest.approx((0.05, 0, 0))
    low, high = bounds(small.spec.object("box").spec)
    assert np.allclose(high - low, 0.1)
    with pytest.raises(SpecError, match="is it in millimeters"):
        doubt_unit(scaled_scene(given, 10).spec)
    with pytest.raises(SpecError, match="is it in kilometers"):
        doubt_unit(scaled_scene(given, 1e-5).spec)
    with pytest.raises(SpecError, match="--scale: got 0"):
        scaled_scene(given, 0)
    file = tmp_path / "large.glb"
    file.write_bytes(glb_bytes(given.spec))
    with pytest.raises(SpecError, match="centimeters"):
        rescue_file(file, tmp_path / "out")


def test_a_closed_room_is_doubted_and_objects_that_are_sunk_are_not():
    given = boxes(
        room=((4, 4, 2.6), (0, 0, 1.3)), stool=((0.6, 0.6, 0.5), (0.5, 0.5, 0.27)),
        outside=((0.6, 0.6, 0.5), (5, 0.5, 0.27)),
    )  # fmt: skip
    with pytest.raises(SpecError, match=r"room is solid and encloses objects.*\(stool by 2\.6 m\)"):
        doubt_solids(given.spec)
    doubt_solids(
        boxes(table=((1, 1, 0.4), (0, 0, 0.2)), card=((0.1, 0.1, 0.01), (0, 0, 0.38))).spec
    )

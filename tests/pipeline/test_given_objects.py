"""Known objects in runs: read from files, kept, noticed by --resume, and obeyed by the steps."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

import neoworld_mjx as nw
from neoworld_mjx.errors import EvidenceError
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.evidence_file import StatedEvidence
from neoworld_mjx.evidence.known_objects import KnownObjects, KnownSize
from neoworld_mjx.export import urdf_text
from neoworld_mjx.parse.photo import load_photo
from neoworld_mjx.parse.prompts import parse_request
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.pipeline.annotated import read_annotation, write_annotated
from neoworld_mjx.pipeline.rescue import rescue_file
from neoworld_mjx.spec import Cylinder, ObjectSpec, bounds, read_scene, world_poses
from tests.support.annotations import coffee
from tests.support.made_up_view import picture
from tests.support.mesh_scenes import write_poses
from tests.support.scenes import CERAMIC, single, stored_scene


def mug(height=0.09):
    return single("mug", (Cylinder(radius=0.04, height=height), (0, 0, 0)), material=CERAMIC)


def size_of(item):
    low, high = bounds(item.spec, item.joint_state)
    return high - low


@pytest.fixture
def assets(tmp_path):
    """A URDF, a mesh in meters and one in millimeters, and an evidence file that names them."""
    (tmp_path / "mug.urdf").write_text(urdf_text(mug()))
    mesh = trimesh.creation.cylinder(radius=0.04, height=0.09)
    mesh.export(tmp_path / "mug.stl")
    mesh.export(tmp_path / "mug.glb")
    mesh.apply_scale(1000).export(tmp_path / "mm.stl")
    (tmp_path / "evidence.yaml").write_text(
        "objects: {mug: mug.urdf, big: mm.stl}\n"
        "sizes: {big: {height: 0.2}, jar: {diameter: 0.05}}\n"
        "keep: [lamp]\n"
    )
    return tmp_path


def test_one_file_names_known_objects(assets):
    Image.fromarray(picture()).save(assets / "photo.png")
    read = nw.read_evidence(assets / "evidence.yaml", assets / "photo.png").objects
    assert read.names == ("mug", "big", "jar", "lamp") and read.keep == ("lamp",)
    assert read.sizes["jar"] == KnownSize(diameter=0.05)
    assert read.lines()["sizes"] == "big: height 0.2 m; jar: diameter 0.05 m"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("objects: {mug: no.urdf}", "objects: .*no.urdf"),
        ("objects: {mug: mm.stl}", "in centimeters.*under sizes"),
        ("objects: {mug: evidence.yaml}", "files that can be read"),
        ("sizes: {mug: {length: 1}}", "unknown key sizes.mug.length"),
        ("sizes: {mug: {}}", "give a height, width, depth or diameter"),
        ("sizes: {mug: 0.1}", "sizes.mug"),
        ("keep: lamp", "keep"),
    ],
)
def test_wrong_files_give_one_message(assets, text, message):
    Image.fromarray(picture()).save(assets / "photo.png")
    (assets / "evidence.yaml").write_text(text)
    with pytest.raises(EvidenceError, match=message) as raised:
        nw.read_evidence(assets / "evidence.yaml", assets / "photo.png")
    assert len(str(raised.value).splitlines()) == 1


def test_the_model_is_told_the_names(photo):
    picture = load_photo(photo)
    plain = parse_request(picture)
    request = parse_request(picture, Evidence(objects=KnownObjects(keep=("mug", "lamp"))))
    assert request.prompt.startswith(plain.prompt) and "objects: mug, lamp." in request.prompt


@pytest.fixture(scope="module")
def example(tmp_path_factory, photo, quick_config):
    """The bundled example, whose cup is replaced, and whose saucer has a known size."""
    out = tmp_path_factory.mktemp("known") / "out"
    reconstruct(photo, out, quick_config, until="parse")
    parsed = (out / "tree.json").stat().st_mtime_ns
    known = KnownObjects(
        assets={"cup": mug()}, sizes={"saucer": KnownSize(diameter=0.15)}, keep=("spoon",)
    )
    reconstruct(photo, out, quick_config, resume=True, evidence=nw.Evidence(objects=known))
    return out, parsed


def test_known_objects_replace_programs_and_keep_sizes_and_places(example):
    out, parsed = example
    assert (out / "tree.json").stat().st_mtime_ns != parsed  # Placed again, not asked again.
    asked = {
        e["name"] for e in json.loads((out / "answers.tape.json").read_text())["answers"].values()
    }
    assert "program:saucer" in asked and not any("cup" in name for name in asked)
    assert not (out / "objects" / "cup" / "program.py").exists()
    tree = json.loads((out / "history" / "parse" / "tree.json").read_text())
    spoon = next(node for node in tree["nodes"] if node["name"] == "spoon")
    for file in ("compose/scene.json", "scene.json"):
        scene = read_scene(out / file)
        assert scene.object("cup").spec == mug()
        assert size_of(scene.object("saucer"))[:2] == pytest.approx([0.15, 0.15], abs=2e-3)
    composed = read_scene(out / "compose" / "scene.json").object("spoon")
    assert composed.known == "pose" and composed.yaw == pytest.approx(spoon["box3d"]["yaw"])


def test_runs_record_known_objects_and_notice_changes(example, photo, quick_config):
    out, _ = example
    data = json.loads((out / "run.json").read_text())
    assert data["evidence"]["used"] == {
        "objects": "cup", "sizes": "saucer: diameter 0.15 m", "keep": "spoon"
    }  # fmt: skip
    notes = {note["what"] for note in data["notes"]}
    assert {"known: objects", "known: keep", "cup is the given asset"} <= notes
    assert "known: sizes" in (out / "report.html").read_text()
    written = lambda name: (out / name).stat().st_mtime_ns
    run = lambda **more: reconstruct(photo, out, quick_config, resume=True, **more)
    first = {name: written(name) for name in ("objects/cup/spec.json", "compose/scene.json")}
    run()
    assert first == {name: written(name) for name in first}
    other = KnownObjects(assets={"cup": mug(0.1)})
    run(evidence=nw.Evidence(objects=other), until="program")
    assert first["objects/cup/spec.json"] != written("objects/cup/spec.json")
    wrong = KnownObjects(keep=("cupp",))
    with pytest.raises(EvidenceError, match=r"keep: no such object: got 'cupp', valid are: .*cup"):
        run(evidence=nw.Evidence(objects=wrong), until="compose")


def test_annotated_runs_use_known_objects(tmp_path, photo, quick_config):
    out = tmp_path / "out"
    known = nw.Evidence(objects=KnownObjects(assets={"cup": mug()}, keep=("cup",)))
    write_annotated(photo, out, coffee(), quick_config, simulate=False, evidence=known)
    again = read_annotation(out)  # All objects keep what they have.
    write_annotated(photo, out, again, quick_config, simulate=False)
    spec = ObjectSpec.model_validate_json((out / "objects" / "cup" / "spec.json").read_text())
    assert spec == mug() and not (out / "objects" / "cup" / "program.py").exists()
    with pytest.raises(EvidenceError, match="keep: no such object: got 'mug'"):
        wrong = nw.Evidence(objects=KnownObjects(keep=("mug",)))
        write_annotated(photo, out, again, quick_config, simulate=False, evidence=wrong)


def test_a_rescue_keeps_sizes_and_places(tmp_path):
    truth = stored_scene("three_apart")
    names = [item.name for item in truth.objects if not item.static]
    given = StatedEvidence(sizes={names[0]: KnownSize(height=0.123)}, keep=(names[1],))
    file = write_poses(tmp_path / "in", truth)
    rescue_file(file, tmp_path / "out", evidence=given)
    composed = read_scene(tmp_path / "out" / "compose" / "scene.json")
    assert size_of(composed.object(names[0]))[2] == pytest.approx(0.123, abs=1e-6)
    was, now = (world_poses(scene)[names[1]].pos[:2] for scene in (truth, composed))
    assert np.allclose(was, now, atol=1e-6)
    with pytest.raises(EvidenceError, match="objects: the objects are those of the scene's file"):
        rescue_file(file, tmp_path / "a", evidence=StatedEvidence(objects={names[0]: "a.urdf"}))
    with pytest.raises(EvidenceError, match="keep: no such object: got 'lamp'"):
        rescue_file(file, tmp_path / "b", evidence=StatedEvidence(keep=("lamp",)))

"""Scenes as SDF worlds and Drake's directives, and world poses in scene.json."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from neoworld_mjx.export import export_scene
from neoworld_mjx.export.drake_contact import DRAKE
from neoworld_mjx.export.link_frames import link_names
from neoworld_mjx.export.write_sdf import sdf_text
from neoworld_mjx.export.write_urdf import urdf_text
from neoworld_mjx.physics.mjcf import excluded_pairs
from neoworld_mjx.spec import SceneSpec, world_poses
from neoworld_mjx.spec.pose import from_matrix
from neoworld_mjx.spec.pose import matrix as rotation


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scene):
    out = tmp_path_factory.mktemp("worlds")
    export_scene(scene, out)
    return out


def from_rpy(roll, pitch, yaw):
    about = [
        [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]],
        [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]],
        [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]],
    ]
    x, y, z = (np.array(turn) for turn in about)
    return z @ y @ x


def test_an_sdf_world_has_the_poses_of_all_objects(folder, scene):
    world = ET.parse(folder / "scene.sdf").getroot().find("world")
    models = {model.get("name"): model for model in world.findall("model")}
    poses = world_poses(scene)
    assert set(models) == set(poses)
    for name, at in poses.items():
        numbers = [float(v) for v in models[name].find("pose").text.split()]
        assert np.allclose(numbers[:3], at.pos, atol=1e-12)
        assert np.allclose(from_rpy(*numbers[3:]), rotation(at.quat), atol=1e-12)
    for uri in world.iter("uri"):
        assert (folder / uri.text).is_file()
    assert models["physics"].find("static").text == "true"
    hold = next(j for j in models["fastened"].findall("joint") if j.find("parent").text == "world")
    assert hold.find("child").text == "cabinet"
    joints = {j.get("name"): j for j in models["box"].findall("joint")}
    assert joints["gear"].find("axis/mimic").get("joint") == "follow"
    assert joints["hinge"].find("axis/limit/upper").text == "1.6"
    frames = {f.get("name"): f.get("attached_to") for f in models["box"].findall("frame")}
    assert frames["pull"] == "knob" and frames["drawer_handle"] == "drawer"


def test_drake_directives_set_poses_welds_and_joint_positions(folder, scene):
    import yaml

    class Loader(yaml.SafeLoader):
        pass

    Loader.add_constructor("!Rpy", lambda loader, node: loader.construct_mapping(node, deep=True))
    steps = yaml.load((folder / "scene.dmd.yaml").read_text(), Loader)["directives"]
    added = {s["add_model"]["name"]: s["add_model"] for s in steps if "add_model" in s}
    described = ET.parse(folder / "package.xml")
    package = described.find("name").text
    # The files are the user's: they name neither a maintainer nor a licence that nobody stated.
    assert described.find("maintainer") is None and described.find("license") is None
    for model in added.values():
        head, _, path = model["file"].partition(f"package://{package}/")
        assert head == "" and (folder / path).is_file()
    welds = {s["add_weld"]["child"]: s["add_weld"] for s in steps if "add_weld" in s}
    assert set(welds) == {"physics::table", "fastened::cabinet"}
    assert added["box"]["default_joint_positions"]["hinge"] == [0.8]
    # A joint that follows stands where its leader puts it.
    assert added["box"]["default_joint_positions"]["follow"] == [pytest.approx(0.6)]
    at = world_poses(scene)["bowl"]
    placed = added["bowl"]["default_free_body_pose"]["bowl"]
    assert np.allclose(placed["translation"], at.pos)
    turn = from_rpy(*np.radians(placed["rotation"]["deg"]))
    assert np.allclose(abs(from_matrix(turn) @ at.quat), 1)


def test_scene_json_has_world_poses_and_is_read_back(folder, scene):
    text = (folder / "scene.json").read_text()
    poses = json.loads(text)["world_poses"]
    for name, at in world_poses(scene).items():
        assert np.allclose(poses[name]["pos"], at.pos) and np.allclose(poses[name]["quat"], at.quat)
    assert SceneSpec.model_validate_json(text) == scene


def test_names_in_an_sdf_model_are_unique(cabinet):
    joints = [
        joint.model_copy(update={"name": joint.child}) if joint.name == "slide" else joint
        for joint in cabinet.joints
    ]
    joints = [
        joint.model_copy(update={"mimic": joint.mimic.model_copy(update={"joint": "drawer"})})
        if joint.mimic is not None and joint.mimic.joint == "slide" else joint
        for joint in joints
    ]  # fmt: skip
    spec = cabinet.model_copy(update={"joints": tuple(joints)})
    model = ET.fromstring(sdf_text(spec)).find("model")
    names = [child.get("name") for child in model if child.get("name")]
    assert len(names) == len(set(names)) and {"drawer", "drawer_"} <= set(names)
    tied = [mimic.get("joint") for mimic in model.iter("mimic")]
    assert set(tied) <= set(names) and "drawer" not in tied


@pytest.mark.parametrize("form", ["urdf", "sdf"])
def test_drake_reads_compliance_and_which_links_never_collide(form, cabinet):
    root = ET.fromstring((urdf_text if form == "urdf" else sdf_text)(cabinet))
    drake = f"{{{DRAKE}}}"

    def value(element):
        return element.text if form == "sdf" else next(iter(element.attrib.values()))

    colliders = list(root.iter("collision"))
    assert colliders
    for collider in colliders:
        properties = collider.find(f"{drake}proximity_properties")
        assert properties.find(f"{drake}compliant_hydroelastic") is not None
        assert float(value(properties.find(f"{drake}hydroelastic_modulus"))) == 1e8
        mesh = collider.find("geometry/mesh")
        assert mesh is None or mesh.find(f"{drake}declare_convex") is not None
        radius = collider.find("geometry/cylinder")
        hint = properties.find(f"{drake}mesh_resolution_hint")
        if collider.find("geometry/box") is not None or (mesh is not None and form == "sdf"):
            assert hint is None
        if radius is not None:
            assert float(value(hint)) > 0
    groups = {}
    for group in root.iter(f"{drake}collision_filter_group"):
        member = value(group.find(f"{drake}member"))
        others = group.findall(f"{drake}ignored_collision_filter_group")
        groups[group.get("name")] = (member, [value(other) for other in others])
    never = {(one, groups[name][0]) for one, names in groups.values() for name in names}
    links = link_names(cabinet)
    joined = {(links[joint.parent], links[joint.child]) for joint in cabinet.joints}
    meant = {(links[one], links[other]) for one, other in excluded_pairs(cabinet)}
    # Drake leaves out by itself what a joint joins.
    assert never == meant - joined
    assert never

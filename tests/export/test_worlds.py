"""Scenes as SDF worlds, and world poses in scene.json."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from neoworld_mjx.export.write_sdf import sdf_text
from neoworld_mjx.spec import world_poses
from neoworld_mjx.spec.pose import matrix as rotation


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


def test_a_mimic_in_sdf_has_the_multiplier_and_the_offset_of_its_joint(cabinet):
    model = ET.fromstring(sdf_text(cabinet)).find("model")
    mimics = {j.get("name"): j.find("axis/mimic") for j in model.findall("joint")}
    followers = [joint for joint in cabinet.joints if joint.mimic is not None]
    assert any(joint.mimic.offset not in (0, joint.mimic.multiplier) for joint in followers)
    for joint in followers:
        written = mimics[joint.name]
        assert float(written.find("multiplier").text) == pytest.approx(joint.mimic.multiplier)
        assert float(written.find("offset").text) == pytest.approx(joint.mimic.offset)
        assert float(written.find("reference").text) == 0

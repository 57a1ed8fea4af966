"""MJCF files beside other files: readers, robots, sensors and handles."""

import re
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest

from neoworld_mjx.physics.mjcf import START, to_mjspec

ROBOT = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="base" pos="3 0 0">
<geom size=".1"/><body name="tip" pos="0 0 .2"><joint name="tip" axis="0 1 0" range="-1 1"/>
<geom type="capsule" size=".03 .2"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("file", ["scene.xml", "alone/object.xml"])
def test_meshes_are_files_and_names_have_no_slash(file, folder):
    root = ET.parse(folder / file).getroot()
    meshes = list(root.iter("mesh"))
    assert len(meshes) > 3
    for mesh in meshes:
        assert not {"vertex", "face", "normal"} & set(mesh.attrib)
        assert ((folder / file).parent / mesh.attrib["file"]).is_file()
    names = [element.get("name", "") for element in root.iter()]
    assert not [name for name in names if "/" in name]


def test_a_scene_can_be_included_with_a_robot(folder, scene):
    (folder / "robot.xml").write_text(ROBOT)
    (folder / "both.xml").write_text(
        '<mujoco><include file="scene.xml"/><include file="robot.xml"/></mujoco>'
    )
    model = mujoco.MjModel.from_xml_path(str(folder / "both.xml"))
    own = to_mjspec(scene).compile()
    assert model.nq == own.nq + 1
    # The robot states no inertia, and gets that of its geoms.
    assert model.body("tip").mass[0] > 0.1
    start = model.key(START).qpos
    assert np.allclose(start[: own.nq], own.key(START).qpos)


def test_two_copies_of_an_object_can_be_attached_with_a_robot(folder, cabinet):
    (folder / "robot.xml").write_text(ROBOT.replace('"arm"', '"arm"', 1))
    (folder / "attached.xml").write_text(
        '<mujoco><asset><model name="c" file="alone/object.xml"/>'
        '<model name="arm" file="robot.xml"/></asset><worldbody>'
        '<frame pos="0 0 0"><attach model="c" body="cabinet" prefix="one-"/></frame>'
        '<frame pos="0 2 0"><attach model="c" body="cabinet" prefix="two-"/></frame>'
        '<attach model="arm" body="base" prefix="arm-"/></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_path(str(folder / "attached.xml"))
    mass = to_mjspec(cabinet).compile().body_mass.sum()
    for name in ("one-cabinet", "two-cabinet"):
        assert model.body_subtreemass[model.body(name).id] == pytest.approx(mass)
    assert model.joint("two-cabinet-hinge").range.tolist() == pytest.approx([-0.2, 1.6])


def test_joints_and_handles_have_sensors(folder, cabinet):
    model = mujoco.MjModel.from_xml_path(str(folder / "alone" / "object.xml"))
    data = mujoco.MjData(model)
    moving = [joint for joint in cabinet.joints if joint.type != "fixed"]
    for k, joint in enumerate(moving):
        data.qpos[model.joint(f"cabinet-{joint.name}").qposadr[0]] = 0.01 * (k + 1)
    mujoco.mj_forward(model, data)
    for k, joint in enumerate(moving):
        assert data.sensor(f"cabinet-{joint.name}-pos").data[0] == pytest.approx(0.01 * (k + 1))
        assert data.sensor(f"cabinet-{joint.name}-vel").data[0] == 0
    touches = [model.sensor(k).name for k in range(model.nsensor)]
    assert "cabinet-drawer_handle-touch" in touches
    assert "cabinet-links_handle-touch" in touches
    assert not [name for name in touches if re.search("(flap|cog)_handle", name)]  # They follow.

"""Import of USD: files of ours as scenes, and files of others in their units, axes and habits."""

import math

import numpy as np
import pytest

from neoworld_mjx.cli import main
from neoworld_mjx.export import import_usd
from neoworld_mjx.export.formats import write_formats
from neoworld_mjx.export.importing_scene import import_file
from neoworld_mjx.spec import Box, Mesh, bounds, inertial, joint_value, link_poses, world_poses

FOREIGN = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Xform "World"
{
    double3 xformOp:translate = (100, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Xform "case" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])
    {
        float physics:mass = 3
        def Cube "wood" (prepend apiSchemas = ["PhysicsCollisionAPI"])
        {
            double size = 2
            float3 xformOp:scale = (10, 20, 5)
            uniform token[] xformOpOrder = ["xformOp:scale"]
            color3f[] primvars:displayColor = [(0.5, 0.5, 0.5)]
        }
        def Xform "door" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysxRigidBodyAPI"])
        {
            double3 xformOp:translate = (12, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
            def Mesh "leaf" (
                prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"]
            )
            {
                uniform token physics:approximation = "convexHull"
                int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
                int[] faceVertexIndices = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6,
                    0, 2, 6, 4, 1, 5, 7, 3]
                point3f[] points = [(0, 0, 0), (0, 0, 4), (0, 20, 0), (0, 20, 4),
                    (1, 0, 0), (1, 0, 4), (1, 20, 0), (1, 20, 4)]
            }
        }
    }
    def PhysicsRevoluteJoint "hinge" (prepend apiSchemas = ["PhysicsDriveAPI:angular"])
    {
        uniform token physics:axis = "Y"
        rel physics:body0 = </World/case/door>
        rel physics:body1 = </World/case>
        point3f physics:localPos1 = (12, 0, 0)
        float physics:lowerLimit = -90
        float physics:upperLimit = 30
        float drive:angular:physics:damping = 2
    }
    def PhysicsFixedJoint "hold"
    {
        rel physics:body1 = </World/case>
        point3f physics:localPos0 = (100, 0, 0)
    }
}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scene):
    out = tmp_path_factory.mktemp("usd")
    write_formats(scene, out, ["usd", "usdz", "mjcf"])
    return out


@pytest.mark.parametrize("file", ["scene.usdc", "scene.usdz", "scene.xml"])
def test_scenes_keep_poses_joint_states_and_fixed_bases(folder, scene, file):
    imported = import_file(folder / file)
    made = imported.spec
    assert [item.name for item in made.objects] == [item.name for item in scene.objects]
    assert np.allclose(made.gravity, scene.gravity)
    want, got = world_poses(scene), world_poses(made)
    for item in scene.objects:
        twin = made.object(item.name)
        assert (twin.environment, twin.fixed_base) == (item.environment, item.fixed_base)
        moved, other = (
            link_poses(item.spec, item.joint_state),
            link_poses(twin.spec, twin.joint_state),
        )
        joints = {joint.name: joint for joint in twin.spec.joints}
        for joint in item.spec.joints:
            if joint.type != "fixed":
                value = joint_value(item.spec, joint, item.joint_state)
                read = joint_value(twin.spec, joints[joint.name], twin.joint_state)
                assert read == pytest.approx(value, abs=1e-5), joint.name
        for part in item.spec.parts:
            named = file.endswith("xml") and part.name == item.spec.root
            other_part = item.name if named else part.name
            one, two = inertial(item.spec, part), inertial(twin.spec, twin.spec.part(other_part))
            assert two.mass == pytest.approx(one.mass, rel=1e-5)
            centre = want[item.name].then(moved[part.name]).apply(one.pos)
            read = got[item.name].then(other[other_part]).apply(two.pos)
            assert np.allclose(read, centre, atol=1e-5), (item.name, part.name)


def test_a_y_up_file_in_centimeters_is_converted(tmp_path):
    path = tmp_path / "a.usda"
    path.write_text(FOREIGN)
    result = import_usd(path)
    spec = result.spec
    low, high = bounds(spec)
    # x stays, USD's z is our -y, its y our z; the leaf reaches up to 20 cm.
    assert np.allclose(high - low, (0.23, 0.1, 0.4), atol=1e-6) and low[2] == pytest.approx(0)
    assert spec.root == "case"
    assert spec.part("case").mass == 3 and spec.part("door").mass is None
    (joint,) = spec.joints
    assert (joint.type, joint.parent, joint.child) == ("revolute", "case", "door")
    # The file's door is body 0: seen from the case it turns the other way.
    assert np.allclose(joint.axis, (0, 0, -1), atol=1e-6)
    assert (joint.lower, joint.upper) == pytest.approx((-math.pi / 2, math.pi / 6))
    # 2 kg cm^2/s per degree.
    assert joint.damping == pytest.approx(2e-4 * 180 / math.pi)
    (case,) = spec.part("case").geoms
    assert isinstance(case.shape, Box) and case.shape.size == pytest.approx((0.2, 0.4, 0.1))
    (leaf,) = spec.part("door").geoms
    assert isinstance(leaf.shape, Mesh) and len(leaf.shape.faces) == 12
    grey = spec.material(case.material).rgba
    assert grey[0] == pytest.approx(0.735, abs=1e-3)  # Linear 0.5 as displayed.
    assert any("door" in note and "no mass" in note for note in result.notes)
    assert any("PhysxRigidBodyAPI" in note for note in result.notes)


def test_one_prim_of_a_scene_is_read_in_its_frame(folder, scene):
    result = import_usd(folder / "scene.usdc", "/scene/bowl")
    low, high = bounds(result.spec)
    want = bounds(scene.object("bowl").spec)
    assert np.allclose(high - low, want[1] - want[0], atol=1e-4)


def test_mirrored_shapes_and_joints_to_the_world(tmp_path):
    path = tmp_path / "a.usda"
    body = (
        'def Cube "{0}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])\n'
        "{{\ndouble size = 0.2\ndouble3 xformOp:translate = ({1}, 0, 0)\n"
        "float3 xformOp:scale = (-1, 1, 2)\n"
        'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]\n}}\n'
    )
    slide = (
        'def PhysicsPrismaticJoint "rail"\n{\nrel physics:body1 = </a>\n'
        'uniform token physics:axis = "Z"\nfloat physics:lowerLimit = 0\n'
        "float physics:upperLimit = 0.5\npoint3f physics:localPos0 = (0, 0, -0.1)\n}\n"
    )
    path.write_text(
        '#usda 1.0\n(\nmetersPerUnit = 1\nupAxis = "Z"\n)\n'
        + body.format("a", 0)
        + body.format("b", 1)
        + slide
    )
    made = import_file(path).spec
    first, second = made.objects
    assert first.fixed_base and first.joint_state["rail"] == pytest.approx(0.1)
    assert not second.static and second.xy == pytest.approx((1.0, 0.0))
    low, high = bounds(second.spec)
    assert np.allclose(high - low, (0.2, 0.2, 0.4), atol=1e-6)


def test_commands_accept_usd(folder, scene, tmp_path, capfd):
    def run(*arguments):
        with pytest.raises(SystemExit) as left:
            main([*arguments, "--json"])
        return left.value.code, "".join(capfd.readouterr())

    code, text = run("export", str(folder / "scene.usdc"), "--out", str(tmp_path / "a"),
                     "--format", "sdf")  # fmt: skip
    assert code == 0 and (tmp_path / "a" / "scene.sdf").exists()
    assert "cameras are not imported" in text
    bowl = folder / "objects" / "bowl" / "object.usdc"
    assert run("build", str(bowl), "--out", str(tmp_path / "b"))[0] == 0
    assert {"object.urdf", "spec.json", "render.png"} <= {
        p.name for p in (tmp_path / "b").iterdir()
    }
    code, text = run("build", str(folder / "scene.usdc"), "--out", str(tmp_path / "c"))
    assert code == 2 and "several objects instead of one" in text

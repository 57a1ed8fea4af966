"""Ground truth of MJCF models."""

from pathlib import Path

import numpy as np
import pytest
from neoworld_bench.measures import geometry_measure, joint_measure, truth_of, truth_of_mjcf

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export import export_object
from neoworld_mjx.program import build

OBJECTS = Path(__file__).parents[2] / "examples" / "objects"
ARM = """
<mujoco>
 <worldbody>
  <geom type="plane" size="1 1 1"/>
  <body name="base">
   <freejoint/>
   <geom type="box" size="0.2 0.1 0.05" pos="0 0 0.05"/>
   <body name="arm" pos="0.2 0 0.1">
    <joint name="swing" axis="0 0 2" range="10 50" ref="30" limited="true"/>
    <geom type="cylinder" size="0.02 0.1" pos="0 0 0.1"/>
    <geom type="sphere" size="0.5" group="3"/>
    <body name="tip" pos="0 0 0.2">
     <joint name="roll" axis="1 0 0"/>
     <joint name="reach" type="slide" axis="0 1 0" range="0 0.3" limited="true"/>
     <geom type="capsule" size="0.01 0.04"/>
    </body>
    <body name="frame"><joint name="empty" axis="0 1 0"/>
     <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
   </body>
  </body>
 </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("name", ["fs_microwave", "ia_cabinet4"])
def test_exported_object_matches_its_ground_truth(name, tmp_path):
    spec = build((OBJECTS / f"{name}.py").read_text()).spec
    export_object(spec, tmp_path)
    path = tmp_path / "object.xml"
    truth, points = truth_of_mjcf(path, samples=4000)
    own = truth_of(spec)
    np.testing.assert_allclose(truth.box, own.box, atol=2e-3)
    assert {j.type for j in truth.joints} == {j.type for j in own.joints}
    result = joint_measure(spec, truth)
    assert result.correct == result.total == len(own.joints) and not result.extra
    assert result.axis_deg.value == pytest.approx(0, abs=1e-4)
    assert result.limits.value == pytest.approx(1, abs=1e-4)
    assert geometry_measure(spec, points, samples=4000).unaligned.f_05 > 99


def test_joints_and_surface_of_an_mjcf_model(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    truth, points = truth_of_mjcf(path, front="-y", samples=500)
    assert truth.front == "-y" and points.shape == (500, 3)
    np.testing.assert_allclose(truth.box, [(-0.2, -0.1, 0), (0.22, 0.1, 0.35)], atol=1e-6)
    joints = {joint.name: joint for joint in truth.joints}
    assert list(joints) == ["swing", "roll", "reach"], (
        "free joints and those that carry nothing are none"
    )
    assert joints["swing"].limits == pytest.approx(np.radians([-20, 20])), "from where it stands"
    np.testing.assert_allclose(joints["swing"].pivot, (0.2, 0, 0.1))
    np.testing.assert_allclose(
        joints["swing"].moving_box, [(0.18, -0.02, 0.1), (0.22, 0.02, 0.35)], atol=1e-6
    )
    assert joints["roll"].type == "continuous" and joints["roll"].limits is None
    assert joints["reach"].type == "prismatic" and joints["reach"].limits == (0, 0.3)


def test_unreadable_models_raise(tmp_path):
    path = tmp_path / "bad.xml"
    path.write_text("<mujoco><worldbody><geom/></worldbody></mujoco>")
    with pytest.raises(SpecError, match=r"bad\.xml"):
        truth_of_mjcf(path)
    path.write_text('<mujoco><worldbody><geom size="1" group="4"/></worldbody></mujoco>')
    with pytest.raises(SpecError, match="no geom of the groups"):
        truth_of_mjcf(path)
    with pytest.raises(SpecError, match=r"none\.xml"):
        truth_of_mjcf(tmp_path / "none.xml")

"""Conventions of file formats that change sizes, limits, files and zeros of joints."""

import re

import numpy as np
import pytest
import trimesh

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.importing import import_file
from neoworld_mjx.spec import bounds

MASS = (
    "<inertial><mass value='1'/><inertia ixx='.01' iyy='.01' izz='.01' ixy='0' ixz='0' iyz='0'/>"
    "</inertial>"
)


def urdf(shape: str, more: str = "") -> str:
    geometry = f"<geometry>{shape}</geometry>"
    return (
        f"<robot name='r'><link name='a'>{MASS}<visual>{geometry}</visual>"
        f"<collision>{geometry}</collision></link>{more}</robot>"
    )


@pytest.mark.parametrize(("unit", "factor"), [("0.001", 0.001), ("0.0254", 0.0254), ("1", 1.0)])
def test_a_collada_mesh_has_the_unit_that_it_states(tmp_path, unit, factor):
    box = trimesh.creation.box(np.array([0.3, 0.2, 0.1]) / factor)
    text = box.export(file_type="dae").decode()
    text = re.sub("<unit[^>]*/>", "", text).replace("<asset>", f"<asset><unit meter='{unit}'/>")
    (tmp_path / "box.dae").write_text(text)
    path = tmp_path / "a.urdf"
    path.write_text(urdf("<mesh filename='box.dae'/>"))
    low, high = bounds(import_file(path).spec)
    assert np.allclose(high - low, [0.3, 0.2, 0.1], atol=1e-6)


@pytest.mark.parametrize(
    "name", ["robot/part.stl", "package://gone/meshes/part.stl", "c:\\part.stl"]
)
@pytest.mark.parametrize("folder", ["assets", ""])
def test_a_mesh_is_found_without_its_folders_as_in_mujoco(tmp_path, name, folder):
    (tmp_path / folder).mkdir(exist_ok=True)
    trimesh.creation.box((0.2, 0.2, 0.2)).export(tmp_path / folder / "part.stl")
    path = tmp_path / "a.urdf"
    settings = f"<mujoco><compiler meshdir='{folder}' boundmass='2'/></mujoco>"
    path.write_text(urdf(f"<mesh filename='{name}'/>", settings if folder else ""))
    imported = import_file(path)
    assert np.allclose(bounds(imported.spec)[1], [0.1, 0.1, 0.2])
    found = f"{folder}/part.stl" if folder else "part.stl"
    assert f"{name} does not exist: {found} is read, as in MuJoCo" in imported.notes
    assert ("settings of MuJoCo are not applied: boundmass=2" in imported.notes) == bool(folder)


def test_a_mesh_folder_outside_the_asset_is_refused(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    trimesh.creation.box((0.2, 0.2, 0.2)).export(tmp_path / "part.stl")
    path = inner / "a.urdf"
    settings = "<mujoco><compiler meshdir='..'/></mujoco>"
    path.write_text(urdf("<mesh filename='x/part.stl'/>", settings))
    with pytest.raises(SpecError, match="names 'x/part"):
        import_file(path)


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
@pytest.mark.parametrize(
    ("stated", "missing", "limits"),
    [("upper='.25'", "lower", (0, 0.25)), ("lower='-.25'", "upper", (-0.25, 0))],
)
def test_a_limit_that_urdf_omits_is_0(tmp_path, kind, stated, missing, limits):
    joint = (
        f"<link name='b'>{MASS}<collision><geometry><box size='.1 .1 .1'/></geometry></collision>"
        f"</link><joint name='j' type='{kind}'><parent link='a'/><child link='b'/>"
        f"<limit {stated} effort='1' velocity='1'/></joint>"
    )
    path = tmp_path / "a.urdf"
    path.write_text(urdf("<box size='.2 .2 .2'/>", joint))
    imported = import_file(path)
    (read,) = imported.spec.joints
    assert (read.type, read.lower, read.upper) == (kind, *limits)
    assert f"joint j states no {missing} limit: it is 0, as in URDF" in imported.notes


def test_changed_names_of_links_and_joints_are_noted(tmp_path):
    joint = (
        f"<link name='arm/1'>{MASS}<collision><geometry><sphere radius='.1'/></geometry>"
        "</collision></link><joint name='left.hip' type='continuous'><parent link='a'/>"
        "<child link='arm/1'/></joint>"
    )
    path = tmp_path / "a.urdf"
    path.write_text(urdf("<box size='.2 .2 .2'/>", joint))
    imported = import_file(path)
    assert [joint.name for joint in imported.spec.joints] == ["left_hip"]
    assert imported.notes == ("names are changed: 'arm/1' is arm_1, 'left.hip' is left_hip",)

"""URDF as other programs read it: frames, friction, names, and parts that do not jam."""

import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest

from neoworld_mjx.export import export_object, import_file
from neoworld_mjx.spec import Ellipsoid, HollowBox, ObjectSpec
from tests.support.mechanisms import WOOD, geom, joint, part


def tight_drawer() -> ObjectSpec:
    """A drawer that touches its case on three sides and below."""
    case = HollowBox(size=(0.3, 0.3, 0.2), wall=0.02, open=("+x",))
    tray = HollowBox(size=(0.28, 0.26, 0.1), wall=0.01)
    return ObjectSpec(
        name="chest",
        materials=(WOOD,),
        parts=(
            part("case", geom("case", case, (0, 0, 0.1))),
            part("drawer", geom("tray", tray, (0.01, 0, 0.07))),
        ),
        joints=(joint("slide", "prismatic", "case", "drawer", axis=(1, 0, 0), upper=0.2),),
    )


def test_a_tight_drawer_slides_in_mujocos_urdf_reader(tmp_path):
    export_object(tight_drawer(), tmp_path)
    moved = []
    for file, name in (("object.urdf", "slide"), ("object.xml", "chest-slide")):
        model = mujoco.MjModel.from_xml_path(str(tmp_path / file))
        data = mujoco.MjData(model)
        model.opt.gravity[:] = 0
        mujoco.mj_forward(model, data)
        slide = model.joint(name)
        assert data.ncon == 0
        while data.time < 0.2:
            data.qfrc_applied[slide.dofadr[0]] = 2.0
            mujoco.mj_step(model, data)
        moved.append(float(data.qpos[slide.qposadr[0]]))
    # In MJCF the whole chest is free and is pushed back a little.
    assert moved[0] > 0.01 and moved[1] > 0.01


def test_an_ellipsoid_rests_on_a_face_of_its_mesh(tmp_path):
    """On a corner at its lowest point, it would tip over in simulators without ellipsoids."""
    fruit = geom("fruit", Ellipsoid(radii=(0.04, 0.04, 0.038)), (0, 0, 0.038))
    export_object(
        ObjectSpec(name="orange", materials=(WOOD,), parts=(part("body", fruit),)), tmp_path
    )
    spec = mujoco.MjSpec.from_file(str(tmp_path / "object.urdf"))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 0.1))
    (body,) = spec.worldbody.bodies
    body.add_freejoint()
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[3:] = (1, 0.01, 0.005, 0)
    while data.time < 1:
        mujoco.mj_step(model, data)
    turned = 2 * np.degrees(np.arccos(min(1, abs(data.qpos[3]))))
    assert turned < 0.5 and abs(data.qpos[2]) < 0.0015
    assert model.mesh("fruit-0").vertnum <= 64  # More corners are too many for PhysX on a GPU.


def test_only_colliders_of_moving_parts_are_shrunk(folder):
    root = ET.parse(folder / "alone" / "object.urdf").getroot()
    sizes = {
        collision.get("name"): np.array(box.get("size").split(), float)
        for collision in root.iter("collision")
        if (box := collision.find("geometry/box")) is not None
    }
    assert np.allclose(sizes["panel-0"], np.array([0.02, 0.2, 0.3]) - 0.001)
    assert np.isclose(max(sizes[k].max() for k in sizes if k.startswith("case-")), 0.4)
    seen = {
        visual.get("name"): box.get("size")
        for visual in root.iter("visual")
        if (box := visual.find("geometry/box")) is not None
    }
    assert seen["panel"] == "0.02 0.2 0.3"


def test_surface_friction_is_read_back_from_urdf(folder):
    result = import_file(folder / "alone" / "object.urdf").spec
    materials = {
        geom.name: result.material(geom.material).friction
        for part in result.parts
        for geom in part.geoms
        if geom.role == "collision"
    }
    # A link states the mean of its colliders.
    assert set(materials.values()) == {0.3, 0.35, 0.4}
    root = ET.parse(folder / "alone" / "object.urdf").getroot()
    door = next(link for link in root.findall("link") if link.get("name") == "links")
    # PyBullet multiplies the coefficients of two links: two such links have 0.4.
    lateral = float(door.find("contact/lateral_friction").get("value"))
    assert lateral**2 == pytest.approx(0.4, abs=1e-4)
    root.remove(root.find("neoworld"))
    foreign = folder / "alone" / "foreign.urdf"
    ET.ElementTree(root).write(foreign)
    assert {m.friction for m in import_file(foreign).spec.materials} >= {lateral}


@pytest.mark.parametrize("file", ["object.urdf", "object.xml"])
def test_sites_and_handles_are_read_back(file, folder, cabinet):
    made = import_file(folder / "alone" / file).spec
    sites = {site.name: site for site in made.sites}
    # Imported objects stand in the middle of their own box.
    low = np.array(sites["pull"].pos) - (0.21, -0.18, 0.15)
    assert sites["pull"].part == "knob"
    handle = sites["drawer_handle"]
    assert handle.part == "drawer"
    assert np.allclose(np.array(handle.pos) - low, (0.1, 0.1, 0.1), atol=0.1)
    # Exported again, they are the same handles and not handles of handles.
    assert len(sites) == 1 + sum(1 for j in cabinet.joints if j.mimic is None and j.type != "fixed")

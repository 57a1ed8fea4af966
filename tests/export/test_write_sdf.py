"""An SDF model has the shapes, poses, masses and joints of the object, read by the rules of SDF."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neoworld_mjx.export.write_sdf import sdf_text
from neoworld_mjx.spec import inertial, pieces
from tests.support import mechanisms


def numbers(element, tag):
    return np.array([float(value) for value in element.findtext(tag).split()])


def placed(element):
    """Return position and rotation matrix of an element in its link's or model's frame."""
    values = numbers(element, "pose") if element.find("pose") is not None else np.zeros(6)
    return values[:3], Rotation.from_euler("xyz", values[3:]).as_matrix()


def in_model(link, element):
    """Return position and rotation matrix of an element of a link in the model's frame."""
    (at, turn), (pos, own) = placed(link), placed(element)
    return at + turn @ pos, turn @ own


@pytest.fixture(scope="module")
def spec():
    """Every shape, and every type of joint."""
    return mechanisms.cabinet()


@pytest.fixture(scope="module")
def model(spec):
    return ET.fromstring(sdf_text(spec)).find("model")


def links_of(spec, model):
    """Pair parts with links, both in the order of the joints from the root."""
    return [(part, link) for (part, _), link in zip(spec.ordered, model.iter("link"), strict=True)]


def test_visuals_are_where_the_shapes_are_seen(spec, model):
    for part, link in links_of(spec, model):
        seen = [geom for geom in part.geoms if geom.role != "collision"]
        for geom, visual in zip(seen, link.findall("visual"), strict=True):
            pos, turn = in_model(link, visual)
            np.testing.assert_allclose(pos, geom.pos, atol=1e-6)
            expected = Rotation.from_quat(geom.quat, scalar_first=True).as_matrix()
            np.testing.assert_allclose(turn, expected, atol=1e-6)
            material = spec.material(geom.material)
            np.testing.assert_allclose(numbers(visual.find("material"), "diffuse"), material.rgba)


def test_collisions_are_the_convex_pieces(spec, model):
    kinds = set()
    for part, link in links_of(spec, model):
        rows = pieces(part)
        for (geom, piece, pose), collision in zip(rows, link.findall("collision"), strict=True):
            pos, turn = in_model(link, collision)
            np.testing.assert_allclose(pos, pose.pos, atol=1e-6)
            expected = Rotation.from_quat(pose.quat, scalar_first=True).as_matrix()
            np.testing.assert_allclose(turn, expected, atol=1e-6)
            (shape,) = collision.find("geometry")
            kinds.add(shape.tag)
            sizes = {child.tag: numbers(shape, child.tag) for child in shape if child.tag != "uri"}
            full = 2 * np.array(piece.size)
            stated = {
                "box": {"size": full},
                "sphere": {"radius": full[:1] / 2},
                "ellipsoid": {"radii": full / 2},
                "cylinder": {"radius": full[:1] / 2, "length": full[1:2]},
                "capsule": {"radius": full[:1] / 2, "length": full[1:2]},
                "mesh": {},
            }[shape.tag]
            assert sizes.keys() == stated.keys()
            for tag, value in stated.items():
                np.testing.assert_allclose(sizes[tag], value, rtol=1e-6)
            friction = collision.find("surface/friction/ode")
            assert numbers(friction, "mu") == numbers(friction, "mu2")
            assert numbers(friction, "mu") == spec.material(geom.material).friction
    assert kinds == {"box", "sphere", "ellipsoid", "cylinder", "capsule", "mesh"}


def test_masses_and_inertias_are_those_of_the_parts(spec, model):
    for part, link in links_of(spec, model):
        expected, stated = inertial(spec, part), link.find("inertial")
        assert numbers(stated, "mass") == pytest.approx(expected.mass, rel=1e-5)
        pos, turn = in_model(link, stated)
        np.testing.assert_allclose(pos, expected.pos, atol=1e-6)
        xx, yy, zz, xy, xz, yz = (
            numbers(stated.find("inertia"), f"i{name}")[0]
            for name in ("xx", "yy", "zz", "xy", "xz", "yz")
        )
        tensor = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        axes = Rotation.from_quat(expected.quat, scalar_first=True).as_matrix()
        of_part = axes @ np.diag(expected.diagonal) @ axes.T
        np.testing.assert_allclose(tensor, of_part, atol=1e-5 * np.trace(of_part))


def test_joints_turn_about_their_axes_within_their_limits(spec, model):
    by_part = {part.name: link for part, link in links_of(spec, model)}
    for joint, element in zip(spec.joints, model.findall("joint"), strict=True):
        child = by_part[joint.child]
        assert element.get("type") == joint.type
        assert element.findtext("child") == child.get("name")
        assert element.findtext("parent") == by_part[joint.parent].get("name")
        if joint.type == "fixed":
            continue
        # The frame of a joint is that of its child's link, unless it has a pose of its own.
        assert element.find("pose") is None
        np.testing.assert_allclose(placed(child)[0], joint.pos, atol=1e-6)
        np.testing.assert_allclose(placed(child)[1], np.eye(3))
        axis = element.find("axis")
        assert numbers(axis, "dynamics/damping") == pytest.approx(joint.damping)
        assert numbers(axis, "dynamics/friction") == pytest.approx(joint.friction)
        if joint.stiffness:
            assert numbers(axis, "dynamics/spring_stiffness") == pytest.approx(joint.stiffness)
        if joint.type == "ball":
            continue
        np.testing.assert_allclose(numbers(axis, "xyz"), joint.axis, atol=1e-6)
        limits = {child.tag: float(child.text) for child in axis.find("limit")}
        expected = {"effort": joint.effort, "velocity": joint.velocity}
        if joint.type != "continuous":
            expected |= {"lower": joint.lower, "upper": joint.upper}
        assert limits == pytest.approx({k: v for k, v in expected.items() if v is not None})

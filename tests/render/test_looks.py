"""A composed scene takes its looks from the photograph, and nothing else."""

import mujoco
import numpy as np
import pytest

from neoworld_mjx.export.write_mjcf import mjcf_text
from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.render import render
from neoworld_mjx.render.appearance import linear, read_print
from neoworld_mjx.render.looks import as_photographed, printed
from tests.estimate import desk


@pytest.fixture(scope="module")
def scene():
    return desk.boxed(desk.five())


@pytest.fixture(scope="module")
def photo(scene):
    """The scene in light that is warmer and half as bright, with stripes across the desk."""
    image = render(scene, scene.camera, width=480, supersample=1)
    light = linear(image.color / 255.0) * [0.6, 0.5, 0.4]
    stripes = (np.arange(480) // 40 % 2 == 0)[None, :] & (image.segmentation == 0)
    light[stripes] = [0.2, 0.02, 0.02]
    light[image.segmentation < 0] = linear(np.array([0.2, 0.4, 0.6]))
    return np.round(255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8)


@pytest.fixture(scope="module")
def looks(scene, photo):
    return as_photographed(scene, photo)


def test_the_camera_has_the_exposure_and_white_balance_of_the_photograph(looks):
    red, green, blue = looks.camera.gain
    assert green == pytest.approx(0.5, abs=0.1)
    assert red / green == pytest.approx(1.2, abs=0.1)
    assert blue / green == pytest.approx(0.8, abs=0.1)


def test_the_picture_is_like_the_photograph(scene, photo, looks):
    def difference(one) -> float:
        seen = render(one, one.camera, width=480, supersample=1).color
        return float(np.abs(seen - photo.astype(float)).mean())

    assert difference(looks) < 0.3 * difference(scene)


def test_flat_faces_wear_the_photograph_and_round_ones_do_not(looks):
    printed = {
        item.name: any(m.photo is not None for m in item.spec.materials) for item in looks.objects
    }
    assert printed["desk"] and printed["box"] and not printed["ball"]
    (top,) = looks.object("desk").spec.materials
    columns = linear(read_print(top.photo).colours / 255.0).mean(axis=0)
    # Red stripes on gray: green alternates while the plain color is the mean of both.
    assert columns[:, 1].min() < 0.05 < 0.09 < columns[:, 1].max()
    assert 0.05 < linear(np.array(top.rgba[1])) < 0.09


def test_what_a_simplified_object_does_not_cover_is_no_print_on_its_support(scene):
    photo = desk.photograph(scene, 640).copy()
    white, box = (250, 250, 250), scene.object("ball").box2d
    left, bottom = round(box.x0), round(box.y1)
    photo[bottom - 10 : bottom, left : left + 10] = white  # Of the ball, in its box.
    photo[440:460, 300:320] = white  # A sheet of paper that is not listed stays.
    whole = printed(scene, photo)
    after = render(whole, whole.camera, width=640, shadows=False, supersample=1).color.astype(int)
    assert after[450, 310].min() > 200
    assert after[bottom - 5, left + 5].max() < 150
    assert np.ptp(after[bottom - 5, left + 5]) < 15  # gray, as the desk


def test_the_backdrop_is_seen_and_touches_nothing(scene, looks):
    assert looks.backdrop.rgb == pytest.approx((0.2, 0.4, 0.6), abs=0.03)
    image = render(looks, looks.camera, width=240, supersample=1)
    top = image.color[0, image.segmentation[0] < 0]
    assert len(top) and np.abs(top / 255.0 - [0.2, 0.4, 0.6]).max() < 0.03
    text = mjcf_text(looks)
    assert "backdrop" in text and "backdrop" not in mjcf_text(scene)
    world = mujoco.MjSpec.from_string(_without_files(text)).worldbody
    (plane,) = [geom for geom in world.geoms if geom.name == "backdrop"]
    assert plane.contype == 0 and plane.conaffinity == 0


def test_physics_is_unchanged(scene, looks):
    one, other = (to_mjspec(s).compile() for s in (scene, looks))
    for field in ("body_mass", "body_inertia", "body_pos", "body_quat", "geom_pos", "geom_size",
                  "geom_friction", "geom_type", "mesh_vert", "qpos0", "key_qpos"):  # fmt: skip
        assert np.array_equal(getattr(one, field), getattr(other, field)), field
    contacts = []
    for model in (one, other):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_step(model, data, 100)
        contacts.append((data.ncon, data.qpos.copy()))
    assert contacts[0][0] == contacts[1][0] > 0
    assert np.array_equal(contacts[0][1], contacts[1][1])


def _without_files(text: str) -> str:
    """Return MJCF without what needs files."""
    import xml.etree.ElementTree as ET

    root = ET.fromstring(text)
    for tag in ("asset", "keyframe", "sensor"):
        for element in root.findall(tag):
            root.remove(element)
    for body in root.findall("worldbody/body"):
        root.find("worldbody").remove(body)
    return ET.tostring(root, encoding="unicode")

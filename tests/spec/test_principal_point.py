"""The principal point of a camera: projection, rendering, resizing and MuJoCo's camera agree."""

import mujoco
import numpy as np

from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.render import render
from neoworld_mjx.render.view import View
from neoworld_mjx.spec import Camera, Cylinder, SceneObject, SceneSpec
from tests.support.scenes import single

CAMERA = Camera(
    width=320, height_px=240, fovy=0.7, height=0.5, pitch=0.4, roll=0.1, principal=(31.0, -17.0)
)


def can(xy):
    spec = single("can", (Cylinder(radius=0.02, height=0.04), (0, 0, 0.02)))
    return SceneObject(name="can", spec=spec, xy=xy)


def test_rays_pass_through_the_pixels_of_projected_points():
    points = np.array([[1.0, 0.1, 0.2], [0.7, -0.2, 0.0]])
    pixels, _ = CAMERA.project(points)
    rays = points - CAMERA.position()
    expected = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    assert np.allclose(CAMERA.rays(pixels), expected)
    assert np.allclose(View.of(CAMERA).rays(pixels), expected)


def test_principal_point_shifts_the_image():
    plain = CAMERA.model_copy(update={"principal": (0.0, 0.0)})
    point = [1.0, 0.1, 0.2]
    assert np.allclose(CAMERA.project(point)[0] - plain.project(point)[0], [31.0, -17.0])


def test_rendered_object_is_where_it_projects():
    scene = SceneSpec(objects=(can((0.9, 0.1)),), camera=CAMERA)
    view = render(scene, CAMERA, supersample=1, floor=False, shadows=False)
    rows, columns = np.nonzero(view.segmentation == 0)
    middle = np.array([columns.mean(), rows.mean()]) + 0.5
    expected, _ = CAMERA.project([0.9, 0.1, 0.02])
    assert np.linalg.norm(middle - expected) < 1.0


def test_mujoco_sees_the_same_image():
    model = to_mjspec(SceneSpec(objects=(can((0.9, 0.1)),), camera=CAMERA)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view, option = mujoco.MjvScene(model, 10), mujoco.MjvOption()
    camera = mujoco.MjvCamera()
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, view)
    frustum = view.camera[0]
    focal, near = CAMERA.focal, frustum.frustum_near
    left, top = -CAMERA.center * near / focal
    right, bottom = (np.array([CAMERA.width, CAMERA.height_px]) - CAMERA.center) * near / focal
    assert np.isclose(frustum.frustum_center, (left + right) / 2, rtol=1e-4)
    assert np.isclose(frustum.frustum_top, -top, rtol=1e-4)
    assert np.isclose(frustum.frustum_bottom, -bottom, rtol=1e-4)

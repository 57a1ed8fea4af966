import math

import mujoco
import numpy as np
import pytest

from neoworld_mjx.physics.mjcf import to_mjspec
from neoworld_mjx.render import View, render_object, render_scene
from neoworld_mjx.render.ray_caster import RayCaster
from neoworld_mjx.spec import (
    Box,
    Camera,
    Lathe,
    Material,
    ObjectSpec,
    SceneObject,
    SceneSpec,
    Shape,
    Sphere,
)
from tests.support.mechanisms import geom, joint, part

PAINT = Material(name="paint", density=500, rgba=(0.8, 0.2, 0.1, 1))
WOOD = Material(name="wood", density=600, rgba=(0.6, 0.4, 0.2, 1))


def thing(name: str, shape: Shape, z: float, material: Material = PAINT) -> ObjectSpec:
    body = part("body", geom("body", shape, (0, 0, z), material.name))
    return ObjectSpec(name=name, materials=(material,), parts=(body,))


CAMERA = Camera(width=200, height_px=150, fovy=math.radians(40), height=0.6, pitch=math.radians(35))


def scene() -> SceneSpec:
    table = thing("table", Box(size=(1.2, 1.2, 0.04)), -0.02, WOOD)
    ball = thing("ball", Sphere(radius=0.08), 0.08)
    bowl = thing("bowl", Lathe(profile=((0, 0), (0.05, 0), (0.1, 0.06)), thickness=0.004), 0)
    return SceneSpec(
        objects=(
            SceneObject(name="table", spec=table, environment=True, xy=(0.8, 0)),
            SceneObject(name="ball", spec=ball, parent="table", xy=(0, 0.15)),
            SceneObject(name="bowl", spec=bowl, parent="table", xy=(0, -0.15), yaw=1.0),
        ),
        camera=CAMERA,
    )


def test_segmentation_and_depth_agree_with_the_camera():
    picture = render_scene(scene(), supersample=1)
    assert picture.color.shape == (150, 200, 3) and picture.color.dtype == np.uint8
    assert picture.names == ("table", "ball", "bowl")
    at = np.array([[0.8, 0.15, 0.08]])
    (u, v), depth = CAMERA.project(at)[0][0], CAMERA.project(at)[1][0]
    row, column = int(v), int(u)
    assert picture.segmentation[row, column] == 1
    # The ball's near point lies one radius before its centre along the ray through the centre.
    ray = CAMERA.rays(np.array([[column + 0.5, row + 0.5]]))[0]
    cosine = ray @ CAMERA.axes()[:, 2]
    assert picture.depth[row, column] == pytest.approx(depth - 0.08 * cosine, abs=2e-4)
    mask = picture.segmentation == 1
    rows, columns = np.nonzero(mask)
    rays = CAMERA.rays(np.column_stack([columns, rows]) + 0.5)
    reach = picture.depth[mask] / (rays @ CAMERA.axes()[:, 2])
    hit = CAMERA.position() + rays * reach[:, None]
    radial = (hit - at) / 0.08
    assert np.allclose(np.linalg.norm(radial, axis=1), 1, atol=1e-6)
    assert np.allclose(picture.normal[mask], radial, atol=1e-6)
    assert np.isinf(picture.depth[picture.segmentation == -1]).all()


def test_meshes_have_smooth_normals():
    shape = Lathe(profile=((0.1, 0), (0.1, 0.2)), sectors=8)
    view = View.look_at((1, 0.3, 0.1), (0, 0, 0.1), width=120, height=120)
    picture = render_object(thing("can", shape, 0), camera=view, width=120, height=120)
    rows, columns = np.nonzero((picture.segmentation == 0) & (np.abs(picture.normal[..., 2]) < 0.5))
    rays = view.rays(np.column_stack([columns, rows]) + 0.5)
    reach = picture.depth[rows, columns] / (rays @ view.axes[:, 2])
    hit = (view.eye + rays * reach[:, None])[:, :2]
    radial = hit / np.linalg.norm(hit, axis=1, keepdims=True)
    off = np.degrees(
        np.arccos(np.sum(picture.normal[rows, columns, :2] * radial, axis=1).clip(-1, 1))
    )
    # A facet alone is up to 2.8 degrees off.
    assert off.max() < 1.0
    assert len(rows) > 1000


def test_shadows_point_away_from_the_light():
    bare = SceneSpec(objects=scene().objects[:1], camera=CAMERA)
    with_, without = render_scene(scene()), render_scene(bare)
    same = (with_.segmentation == 0) & (without.segmentation == 0)
    darker = without.color.astype(int).sum(axis=2) - with_.color.astype(int).sum(axis=2)
    assert (darker[same] > 60).sum() > 100
    # The light stands to the camera's left, so shadows lie to the right of what casts them.
    ball = np.nonzero(with_.segmentation == 1)[1].mean()
    columns = np.nonzero(same & (darker > 60))[1]
    near = columns[(columns > ball - 40) & (columns < ball + 40)]
    assert near.mean() > ball


def test_joint_states_and_geom_roles_show_in_images():
    lid = part("lid", geom("lid", Box(size=(0.2, 0.2, 0.02)), (0, 0, 0.11), "paint"))
    hidden = geom("hull", Box(size=(0.5, 0.5, 0.5)), (0, 0, 0.25), "paint", role="collision")
    body = part("body", geom("body", Box(size=(0.2, 0.2, 0.1)), (0, 0, 0.05), "paint"), hidden)
    hinge = joint("hinge", "revolute", "body", "lid", (-0.1, 0, 0.1), (0, -1, 0), upper=1.6)
    box = ObjectSpec(name="box", materials=(PAINT,), parts=(body, lid), joints=(hinge,))
    closed = render_object(box, width=90, height=60)
    opened = render_object(box, {"hinge": 1.5}, width=90, height=60)
    for picture in (closed, opened):
        seen = picture.segmentation == 0
        assert seen.any() and not seen[[0, -1]].any() and not seen[:, [0, -1]].any()
    tall = [
        np.ptp(np.nonzero(p.segmentation == 0)[0]) / np.ptp(np.nonzero(p.segmentation == 0)[1])
        for p in (closed, opened)
    ]
    assert tall[1] > 1.3 * tall[0]


def test_batched_rays_hit_the_same_geoms_as_single_rays():
    # A cabinet's body is heavier on one side, so its inertial frame lies askew in it.
    boxes = {
        "top": ((0.35, 0.8, 0.03), (0, 0, 0.785)),
        "back": ((0.02, 0.8, 0.7), (-0.165, 0, 0.43)),
        "bottom": ((0.35, 0.8, 0.02), (0, 0, 0.09)),
        **{
            f"leg_{i}{j}": ((0.04, 0.04, 0.08), (x, y, 0.04))
            for i, x in enumerate((-0.15, 0.15))
            for j, y in enumerate((-0.38, 0.38))
        },
    }
    geoms = [geom(name, Box(size=size), pos, "paint") for name, (size, pos) in boxes.items()]
    cabinet = ObjectSpec(name="cabinet", materials=(PAINT,), parts=(part("body", *geoms),))
    model = to_mjspec(cabinet, visual=True).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    caster = RayCaster(model, data)
    eye = np.array([1.88, 1.03, 0.83])
    across, up = np.meshgrid(np.linspace(-0.35, 0.35, 60), np.linspace(-0.45, 0.1, 50))
    away = -eye[:2] / np.linalg.norm(eye[:2])
    side = np.array([-away[1], away[0]])
    flat = away + across.reshape(-1, 1) * side
    rays = np.column_stack([flat, up.ravel()])
    alone = []
    groups, met = np.zeros(6, np.uint8), np.zeros(1, np.int32)
    groups[1] = 1
    for ray in rays:
        mujoco.mj_ray(model, data, eye, ray, groups, True, -1, met)
        alone.append(int(met[0]))
    found = caster.hits(eye, rays).geom
    assert np.array_equal(found, alone)
    legs = [model.geom(g).name for g in set(alone) if g >= 0]
    assert sum("leg" in name for name in legs) >= 3

"""Formats on demand: binary USD, packages, glTF, files for MJX, and what each of them loses."""

import json
import zipfile

import mujoco
import numpy as np
import pytest
import trimesh
from pxr import Usd, UsdGeom, UsdUtils

from neoworld_mjx.cli import main
from neoworld_mjx.export.formats import (
    collider_error,
    write_formats,
)
from neoworld_mjx.names import FORMATS
from neoworld_mjx.spec import Box, Cylinder, SceneObject, SceneSpec
from tests.support import mechanisms


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scene):
    out = tmp_path_factory.mktemp("formats")
    write_formats(scene, out, FORMATS)
    return out


def world_bounds(stage, path):
    cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"])
    box = cache.ComputeWorldBound(stage.GetPrimAtPath(path)).ComputeAlignedRange()
    return np.array([list(box.GetMin()), list(box.GetMax())])


def test_binary_usd_and_usdz_contain_the_scene(folder):
    boxes = []
    for file in ("scene.usdc", "scene.usdz"):
        stage = Usd.Stage.Open(str(folder / file))
        boxes.append(world_bounds(stage, "/scene/box"))
        assert stage.GetPrimAtPath("/scene/bowl/links/body/collisions")
    assert np.allclose(*boxes) and np.ptp(boxes[0], axis=0).min() > 0.1
    assert (folder / "scene.usdc").read_bytes()[:8] == b"PXR-USDC"
    packed = zipfile.ZipFile(folder / "scene.usdz").namelist()
    assert any(name.endswith("objects/box/object.usdc") for name in packed)
    assert UsdUtils.ComputeAllDependencies(str(folder / "scene.usdz"))[2] == []


def test_gltf_has_the_visible_geoms_with_y_up(folder, scene):
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    want = world_bounds(stage, "/scene/bowl")
    shown = trimesh.load(folder / "scene.glb")
    corners = np.concatenate(
        [
            trimesh.transform_points(shown.geometry[name].vertices, matrix)
            for node in shown.graph.nodes_geometry
            for matrix, name in [shown.graph[node]]
            if name.startswith("bowl-")
        ]
    )
    x, y, z = corners.T
    turned = np.column_stack([x, -z, y])
    # USD's box is around turned boxes, so it is the larger one.
    assert np.allclose((turned.min(axis=0) + turned.max(axis=0)) / 2, want.mean(axis=0), atol=1e-3)
    assert np.ptp(turned, axis=0)[2] == pytest.approx(np.ptp(want, axis=0)[2], abs=1e-6)
    assert "box-drawer" in shown.graph.nodes
    alone = trimesh.load(folder / "objects" / "bowl" / "object.glb")
    material = next(iter(alone.geometry.values())).visual.material
    assert material.roughnessFactor == pytest.approx(0.6) and material.metallicFactor == 0


def test_colliders_for_mjx_are_within_collider_error(tmp_path):
    can = mechanisms.single("can", Cylinder(radius=0.1, height=0.5), 0.25)
    write_formats(can, tmp_path, ["mjcf"], simulator="mjx")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "object.xml"))
    mesh = model.mesh(0)
    start = mesh.vertadr[0]
    corners = model.mesh_vert[start : start + mesh.vertnum[0]]
    along = int(np.argmax(np.ptp(corners, axis=0)))
    radius = np.linalg.norm(np.delete(corners, along, axis=1), axis=1).max()
    assert radius - 0.1 == pytest.approx(collider_error(can), abs=1e-6)
    assert 0 < collider_error(can) < 0.002


def test_export_writes_files_for_a_simulator_and_reports_losses(tmp_path, cabinet, capfd):
    write_formats(cabinet, tmp_path / "in", ["mjcf"])
    source = str(tmp_path / "in" / "object.xml")
    out = tmp_path / "out"

    def run(*more):
        with pytest.raises(SystemExit) as left:
            main(["export", source, "--out", str(out), "--json", *more])
        return left.value.code

    assert run("--for", "pybullet") == 0
    answer = json.loads(capfd.readouterr().out)
    assert "object.urdf" in answer["files"]
    assert set(answer["lost"]) == {"urdf"}
    assert all((out / file).is_file() for file in answer["files"])
    assert run() == 2
    assert "not empty" in "".join(capfd.readouterr())
    assert "stiffness and armature of joints" in answer["lost"]["urdf"]
    assert not any("ball joints" in text for text in answer["lost"]["urdf"])
    assert run("--for", "newton", "--floor", "--overwrite") == 2
    assert "--floor is written to MJCF only" in "".join(capfd.readouterr())
    assert run("--for", "mjx", "--floor", "--overwrite") == 0
    assert json.loads(capfd.readouterr().out)["collider_error_mm"] > 0
    model = mujoco.MjModel.from_xml_path(str(out / "object.xml"))
    assert model.geom("floor").type[0] == mujoco.mjtGeom.mjGEOM_PLANE


@pytest.mark.parametrize(("z", "floor"), [(0.0, 0.0), (-0.7, -0.7)])
def test_the_floor_is_at_zero_or_below_the_lowest_free_object(tmp_path, z, floor):
    table = mechanisms.single("table", Box(size=(1, 1, 0.04)), 0.02)
    crate = mechanisms.single("crate", Box(size=(0.1, 0.1, 0.1)), 0.05)
    scene = SceneSpec(
        objects=(
            SceneObject(name="table", spec=table, environment=True, z=-0.04),
            SceneObject(name="crate", spec=crate, z=z),
        )
    )
    write_formats(scene, tmp_path, ["mjcf"], floor=True)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert model.geom("floor").pos[2] == pytest.approx(floor)

"""Meshes of parts on the page of `neoworld view`."""

import json
import struct

import numpy as np
import pytest
from neoworld_mjx.view.pages import part_glb as module
from neoworld_mjx.view.pages.part_glb import Detail, detail_of, part_glb
from neoworld_mjx.view.pages.scene_nodes import SceneNodes
from neoworld_mjx.view.pages.view_target import single_object_scene

from neoworld_mjx.program.sandbox import run
from neoworld_mjx.render.appearance import linear
from neoworld_mjx.render.part_meshes import simplified, visible_meshes, visible_triangles
from neoworld_mjx.spec.shapes import Cylinder
from neoworld_mjx.spec.triangles import enclosed_volume

UPRIGHT = np.array([1.0, 0, 0, 0])


@pytest.fixture(scope="module")
def aquarium_like():
    """An object with something opaque and something that is not."""
    built = run(
        "from neoworld_mjx.program.sdk import Object, box, cylinder\n"
        'o = Object("tank", "a tank")\n'
        'wood = o.material("wood", like="oak")\n'
        'glass = o.material("glass", like="glass", rgb=(0.8, 0.9, 1.0), alpha=0.3)\n'
        'body = o.part("body", material=wood)\n'
        'body.add(box((0.2, 0.1, 0.02)), at=(0, 0, 0), by="bottom")\n'
        'body.add(cylinder(0.04, 0.1), material=glass, at=(0, 0, 0.02), by="bottom")\n'
    )
    assert built.spec is not None, built.signals
    return built.spec


def arrays(glb):
    """Return a file's document, positions, normals, colours and faces."""
    magic, version, size = struct.unpack_from("<III", glb)
    assert (magic, version, size) == (0x46546C67, 2, len(glb))
    length = struct.unpack_from("<I", glb, 12)[0]
    document = json.loads(glb[20 : 20 + length])
    content = glb[28 + length :]
    views = [
        content[v["byteOffset"] : v["byteOffset"] + v["byteLength"]]
        for v in document["bufferViews"]
    ]
    floats = [np.frombuffer(view, "<f4").reshape(-1, 3) for view in views[:3]]
    return document, *floats, np.frombuffer(views[3], "<u4").reshape(-1, 3)


def test_opaque_surfaces_become_one_mesh_with_vertex_colors(aquarium_like):
    (part,) = aquarium_like.parts
    opaque, clear = (visible_meshes(aquarium_like, part, opaque=choice) for choice in (True, False))
    assert len(opaque) == len(clear) == 1 and clear[0].alpha == pytest.approx(0.3)
    document, points, normals, colours, faces = arrays(
        part_glb(aquarium_like, part, UPRIGHT, Detail())
    )
    assert np.array_equal(points, opaque[0].vertices) and np.array_equal(faces, opaque[0].faces)
    assert np.allclose(colours, linear(np.array(opaque[0].rgb) / 255), atol=1e-6)
    assert np.allclose(np.abs(normals).max(axis=1), 1, atol=1e-3), "a box keeps its edges"
    assert "extensions" not in document["materials"][0]


def test_baked_light_comes_from_above_in_every_orientation(aquarium_like):
    (part,) = aquarium_like.parts
    for quat in (UPRIGHT, np.array([0.0, 1, 0, 0])):
        document, _, normals, colours, _ = arrays(
            part_glb(aquarium_like, part, quat, Detail(lit=False))
        )
        assert document["extensionsUsed"] == ["KHR_materials_unlit"]
        up = normals[:, 2] * (1 if quat[0] else -1)
        bright = colours.sum(axis=1)
        assert bright[up > 0.9].min() > 1.5 * bright[np.abs(up) < 0.1].max()
        assert bright[up > 0.9].min() > 1.5 * bright[up < -0.9].max()


def test_a_large_scene_is_drawn_with_fewer_triangles(aquarium_like, monkeypatch):
    scene = single_object_scene(aquarium_like)
    assert detail_of(scene, 2.0) == Detail()
    monkeypatch.setattr(module, "LIT_TRIANGLES", visible_triangles(aquarium_like.parts[0]) - 1)
    assert detail_of(scene, 2.0) == Detail(1e-3, lit=False)


@pytest.mark.parametrize(("tolerance", "most"), [(0.0, 256), (1e-3, 120), (1.0, 60)])
def test_a_simplified_surface_stays_closed_and_near(tolerance, most):
    vertices, faces = Cylinder(radius=0.05, height=0.2).surface()
    coarse, triangles = simplified(vertices, faces, tolerance)
    assert 12 <= len(triangles) <= most
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    inside = np.hypot(coarse[:, 0], coarse[:, 1])
    assert inside.max() <= 0.05 + 1e-9 and np.abs(coarse[:, 2]).max() == pytest.approx(0.1)
    lost = 1 - enclosed_volume(coarse, triangles) / enclosed_volume(vertices, faces)
    assert -1e-9 <= lost <= 4 * min(tolerance, 0.004) / 0.05 + 1e-9


def test_a_surface_that_is_not_closed_is_kept():
    vertices, faces = np.eye(3), np.array([[0, 1, 2]])
    assert simplified(vertices, faces, 0.1)[1] is faces


def test_transparent_copies_replace_the_surfaces(aquarium_like):
    pytest.importorskip("viser", reason="the extra viewer is not installed")
    from neoworld_mjx.view.pages.local_server import close_server, open_server

    server = open_server("test", port=0)
    try:
        page = SceneNodes(server, lambda _: None)
        page.show(single_object_scene(aquarium_like))
        assert len(page._visible) == 2 and page._transparent_copies == []
        shown = lambda: tuple(
            {node.visible for node in nodes} for nodes in (page._visible, page._transparent_copies)
        )
        page.set_transparent(True)
        assert shown() == ({False}, {True})
        page.show_visible(False)
        assert shown() == ({False}, {False})
        page.set_transparent(False)
        page.show_visible(True)
        assert shown() == ({True}, {False})
        page.set_transparent(True)
        page.show(single_object_scene(aquarium_like.model_copy(update={"label": "another tank"})))
        assert shown() == ({False}, {True}) and len(page._transparent_copies) == 2
    finally:
        close_server(server)

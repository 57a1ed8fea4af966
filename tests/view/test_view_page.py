"""The page of `neoworld view` in a real browser."""

import shutil
import time

import numpy as np
import pytest

from neoworld_mjx.config import Config
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.spec import read_scene
from neoworld_mjx.templates import template
from tests.support.browser import changed, opened

pytest.importorskip("viser", reason="the extra viewer is not installed")
pytestmark = pytest.mark.slow
CANVAS = 560
"""Columns of the page that the controls never cover."""


@pytest.fixture(scope="module")
def quick_run(tmp_path_factory, photo, quick_config):
    """A finished run of the example with few candidates, which tests copy."""
    out = tmp_path_factory.mktemp("quick") / "out"
    reconstruct(photo, out, quick_config)
    return out


@pytest.fixture
def served():
    """Serve targets, and stop the servers after the test."""
    from neoworld_mjx.view.scene_viewer import SceneViewer
    from neoworld_mjx.view.server import address, close_server, open_server
    from neoworld_mjx.view.target import open_target

    servers = []

    def serve(path):
        server = open_server("test", port=0)
        servers.append(server)
        viewer = SceneViewer(server, open_target(path, Config()))
        return viewer, server, address(server)

    yield serve
    for server in servers:
        close_server(server)


def test_a_joint_slider_moves_geometry_and_the_page_needs_no_network(tmp_path, served):
    program = tmp_path / "chest.py"
    program.write_text(template("drawer_cabinet").program())
    _, _, url = served(program)
    with opened(url) as page:
        page.waits_for("Joints")
        closed = page.settled(right=CANVAS)
        label = page.page.locator("text=/drawer.*, mm/").first.inner_text()
        page.fill(label, 200)
        time.sleep(1)
        opened_up = page.settled(right=CANVAS)
        page.fill(label, 0)
        time.sleep(1)
        again = page.settled(right=CANVAS)
        assert changed(closed, opened_up) > 0.005
        assert changed(closed, again) < 0.002
        assert len(np.unique(closed.reshape(-1, 3), axis=0)) > 50, "nothing is drawn"
        assert page.errors == [] and page.outside == []


def test_a_dragged_object_is_saved_and_composed_where_it_is(
    quick_run, tmp_path, served, photo, quick_config
):
    run = tmp_path / "run"
    shutil.copytree(quick_run, run)
    viewer, server, url = served(run)
    with opened(url) as page:
        page.waits_for("valid: all")
        plain = page.settled(right=CANVAS)
        page.check("Colliders")
        assert changed(plain, page.settled(right=CANVAS)) > 0.005
        page.check("Colliders")
        assert changed(plain, page.settled(right=CANVAS)) < 0.002
        page.choose("Object", "cup")
        page.check("Drag")
        page.settled()
        (client,) = server.get_clients().values()
        start = viewer.placed.handle_pose("cup")
        # The square between the handle's two arrows moves it over the ground.
        square = 0.243 * viewer.handle.scale * (start.then(_unit()).pos - start.pos)
        x, y = _on_screen(client.camera, start.pos + square)
        page.page.mouse.move(x, y)
        page.page.mouse.down()
        page.page.mouse.move(x + 12, y + 6, steps=4)
        page.page.mouse.up()
        deadline = time.monotonic() + 60
        while "cup" not in viewer.placed.patch.objects and time.monotonic() < deadline:
            time.sleep(0.2)
        page.click("Save the placement")
        page.waits_for("Saved in layout.patch.json")
        assert page.errors == [] and page.outside == []
    dragged = viewer.placed.patch.objects["cup"].xy
    assert dragged is not None and dragged != read_scene(run).object("cup").xy
    reconstruct(photo, run, quick_config, resume=True, until="compose")
    assert np.allclose(read_scene(run / "compose" / "scene.json").object("cup").xy, dragged)


def _unit():
    from neoworld_mjx.spec.pose import pose

    return pose([1.0, 1.0, 0.0])


def _on_screen(camera, point):
    """Project a world point [3] m to the pixels of a client."""
    from neoworld_mjx.spec.pose import matrix

    local = matrix(camera.wxyz).T @ (np.asarray(point) - camera.position)
    focal = camera.image_height / 2 / np.tan(camera.fov / 2)
    u, v = local[:2] / local[2] * focal
    return camera.image_width / 2 + u, camera.image_height / 2 + v

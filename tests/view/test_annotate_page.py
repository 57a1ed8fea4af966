"""The page of `neoworld annotate` in a real browser, from an empty page to a stable scene."""

import time

import numpy as np
import pytest

from neoworld_mjx.measure import measured, passes
from neoworld_mjx.parse.photo import load_photo
from neoworld_mjx.pipeline.annotated import write_annotated
from neoworld_mjx.spec import read_scene
from tests.support.annotations import CUP, FOVY_DEG, HEIGHT_M, PITCH_DEG, SAUCER
from tests.support.browser import Page, changed, opened

pytest.importorskip("viser", reason="the extra viewer is not installed")
pytestmark = pytest.mark.slow
PHOTO_SIZE = np.array([600, 400])
EDGES, SAUCER_SIZE = ("depth", "width", "height"), (0.12, 0.12, 0.016)
CHOICES = {"kind": "Kind", "material": "Material", "parent": "Support"}


def test_a_photograph_becomes_a_stable_scene_by_clicks_only(photo, quick_config, tmp_path):
    from neoworld_mjx.view.annotate_page import Annotator, empty_annotation
    from neoworld_mjx.view.server import address, close_server, open_server

    out = tmp_path / "out"
    server = open_server("test", port=0)
    try:
        annotator = Annotator(
            *(server, load_photo(photo), out, empty_annotation(load_photo(photo))),
            lambda annotation, simulate: write_annotated(
                photo, out, annotation, quick_config, simulate=simulate
            ),
        )
        with opened(address(server)) as page:
            page.waits_for("Pitch, deg")
            start = page.settled(right=500)
            camera = lambda: annotator.annotation.camera
            _type(page, "Pitch, deg", PITCH_DEG, lambda: np.degrees(camera().pitch))
            _type(page, "Height, m", HEIGHT_M, lambda: camera().height)
            _type(page, "Field of view, deg", FOVY_DEG, lambda: np.degrees(camera().fovy))
            page.tab("Objects")
            saucer = _draw_box(page, server, annotator, SAUCER)
            _describe(page, saucer, name="saucer", kind="bowl", material="ceramic")
            for k, (edge, size) in enumerate(zip(EDGES, SAUCER_SIZE, strict=True)):
                _type(page, f"Known {edge}, m", size, lambda k=k: annotator._sizes[k].value)
            _until(lambda: saucer().size == SAUCER_SIZE)
            page.choose("Object", "new object")
            page.page.get_by_text("Name", exact=True).wait_for(state="hidden")
            cup = _draw_box(page, server, annotator, CUP)
            _describe(page, cup, name="cup", kind="cup", material="ceramic", parent="saucer")
            # Edits of one object do not change the other.
            assert saucer().size == SAUCER_SIZE and cup().size is None
            page.choose("Object", "saucer")
            _until(lambda: annotator._sizes[2].value == SAUCER_SIZE[2])
            assert changed(start, page.settled(right=500)) > 0.005
            page.tab("Scene")
            page.click("Build the scene")
            page.waits_for("valid: all", 400)
            assert page.errors == [] and page.outside == []
    finally:
        close_server(server)
    for drawn, obj in zip((SAUCER, CUP), annotator.annotation.objects, strict=True):
        assert np.allclose(obj.box.as_tuple(), drawn, atol=3), obj.name
    scene = read_scene(out)
    assert [obj.name for obj in scene.objects] == ["ground", "saucer", "cup"]
    assert passes(measured(scene, quick_config.refine), quick_config.refine)


def _describe(page: Page, obj, **fields: str) -> None:
    """Type and choose what an object is, each when the one before has arrived."""
    _type(page, "Name", fields["name"], lambda: obj().name)
    for field, label in CHOICES.items():
        if field in fields:
            page.choose(label, fields[field])
            _until(lambda field=field: getattr(obj(), field) == fields[field])


def _type(page: Page, label: str, value, arrived) -> None:
    """Type no faster than a person: of two fields within 50 ms viser's page sends the last."""
    page.fill(label, value)
    same = lambda a: a == value if isinstance(value, str) else abs(a - value) < 1e-9
    _until(lambda: same(arrived()))
    time.sleep(0.1)


def _draw_box(page: Page, server, annotator, box):
    """Drag a rectangle, in pixels of the photograph, on the page; return what reads the object."""
    count = len(annotator.annotation.objects)
    page.click("Draw its box")
    page.waits_for("Drag a rectangle")
    time.sleep(1)
    corners = _on_page(server, annotator, np.array(box).reshape(2, 2))
    page.page.mouse.move(*corners[0])
    page.page.mouse.down()
    page.page.mouse.move(*corners[1], steps=6)
    page.page.mouse.up()
    _until(lambda: len(annotator.annotation.objects) == count + 1)
    page.page.get_by_text("Name", exact=True).wait_for()
    return lambda: annotator.annotation.objects[count]


def _on_page(server, annotator, pixels):
    """Return where pixels [n, 2] of the photograph are on the page."""
    (client,) = server.get_clients().values()
    view = client.camera
    focal = view.image_height / 2 / np.tan(view.fov / 2) / annotator.annotation.camera.focal
    window = np.array([view.image_width, view.image_height])
    return (pixels - PHOTO_SIZE / 2) * focal + window / 2


def _until(holds, timeout_s: float = 60.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < deadline, "the page never got there"
        time.sleep(0.2)

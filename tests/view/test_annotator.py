"""Edits of an annotation, alone and from the controls of a page without a browser."""

from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from neoworld_mjx.errors import SpecError
from neoworld_mjx.parse.photo import load_photo
from neoworld_mjx.view.annotate_page import Annotator, empty_annotation, pixel_of
from neoworld_mjx.view.annotated_tree import annotated_tree, annotation_from_tree
from neoworld_mjx.view.annotation import EXISTING_PROGRAM, GROUND
from tests.support.annotations import coffee


def test_children_follow_a_renamed_object_and_those_of_a_deleted_one_move_to_the_ground():
    renamed = coffee().with_change("saucer", {"name": "plate"})
    cup = renamed.find("cup")
    assert cup is not None and cup.parent == "plate" and renamed.find("saucer") is None
    left = coffee().without("saucer")
    assert [(obj.name, obj.parent) for obj in left.objects] == [("cup", GROUND)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parent": "cup"}, "cycle"),
        ({"name": "cup"}, "repeated: cup"),
        ({"name": "../x"}, "name"),
        ({"yaw_deg": 1e9}, "yaw_deg"),
        ({"name": "world"}, "MuJoCo reserves 'world'"),
    ],
)
def test_invalid_changes_are_refused_with_a_short_message(change, message):
    with pytest.raises(SpecError, match=message) as refused:
        coffee().with_change("saucer", change)
    assert "Annotation(" not in str(refused.value)


def test_window_positions_map_to_pixels_of_the_photograph():
    camera = coffee().camera
    # A window of the photograph's height and twice its width shows it in the middle.
    view = SimpleNamespace(image_width=1200, image_height=400, fov=camera.fovy)
    assert np.allclose(pixel_of(view, camera, (0.5, 0.5)), (300, 200))
    assert np.allclose(pixel_of(view, camera, (0.25, 0.0)), (0, 0), atol=1e-6)
    assert np.allclose(pixel_of(view, camera, (1.0, 1.0)), (600, 400))


@pytest.fixture
def opened_page(photo):
    """Open annotations on pages, and stop their servers after the test."""
    pytest.importorskip("viser", reason="the extra viewer is not installed")
    from neoworld_mjx.view.server import close_server, open_server

    servers = []

    def opened(annotation=None):
        servers.append(open_server("test", port=0))
        begin = annotation or empty_annotation(load_photo(photo))
        out = photo.parent / "no_run"
        return Annotator(servers[-1], load_photo(photo), out, begin, lambda *_: pytest.fail())

    yield opened
    for server in servers:
        close_server(server)


def test_opening_an_annotation_and_choosing_its_objects_changes_nothing(opened_page):
    annotation = annotation_from_tree(annotated_tree(coffee()))
    page = opened_page(annotation)
    for name in ("cup", "saucer", "", "cup"):
        page._choose(name)
        assert page.annotation == annotation
    shown = {field: control.value for field, control in page._fields.items()}
    assert (shown["name"], shown["parent"], shown["kind"]) == ("cup", "saucer", EXISTING_PROGRAM)


def test_simultaneous_edits_are_all_kept(opened_page):
    """Viser calls from many threads, in no order, while the values are there already."""
    from viser import GuiEvent

    page = opened_page()
    page.set_box(np.array([77.0, 67.0]), np.array([480.0, 389.0]))
    fields = page._fields
    typed = [(fields["name"], "saucer"), (fields["kind"], "bowl")]
    typed += [(fields["material"], "ceramic"), (fields["label"], "a saucer")]
    typed += list(zip(page._sizes, (0.12, 0.13, 0.016), strict=True))
    with ThreadPoolExecutor(len(typed)) as threads:
        done = []
        for control, value in typed:
            # As viser's server takes what a client sends.
            control._impl.value = value
            event = GuiEvent(None, 1, control)
            done += [threads.submit(call, event) for call in control._impl.update_cb]
        for future in done:
            future.result()
    obj = page.annotation.find("saucer")
    assert obj is not None
    assert (obj.kind, obj.material, obj.label) == ("bowl", "ceramic", "a saucer")
    assert obj.size == (0.12, 0.13, 0.016)
    assert all(control.value == value for control, value in typed)


def typed(control, value):
    """Set the value of a control as viser's server does with what a client sends."""
    from viser import GuiEvent

    control._impl.value = value
    for call in control._impl.update_cb:
        call(GuiEvent(None, 1, control))

import json
import math

import numpy as np
import pytest
from pydantic import ValidationError

from neoworld_mjx.errors import RunError, SpecError
from neoworld_mjx.parse.photo import load_photo
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.pipeline.annotated import ANNOTATION, read_annotation, write_annotated
from neoworld_mjx.spec import Box2D, Box3D, Camera
from neoworld_mjx.view.annotated_tree import annotated_tree, annotation_from_tree, placed_box
from neoworld_mjx.view.annotation import (
    EXISTING_PROGRAM,
    GROUND,
    WRITTEN_BY_MODEL,
    AnnotatedObject,
    Annotation,
)
from tests.support.annotations import coffee

CAMERA = Camera(width=640, height_px=480, fovy=0.9, height=0.5, pitch=0.7)


def _seen(box: Box3D) -> Box2D:
    """Return the 2D box of an upright box."""
    pixels, _ = CAMERA.project(box.corners())
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    return Box2D(x0=x0, y0=y0, x1=x1, y1=y1)


def _object(box, **fields):
    return AnnotatedObject(name="thing", box=box, **fields)


@pytest.mark.parametrize("level", [0.0, 0.12])
def test_a_3d_box_projects_onto_its_2d_box(level):
    true = Box3D(position=(0.6, 0.05, level), size=(0.1, 0.1, 0.16), yaw=math.pi)
    found = placed_box(_object(_seen(true)), CAMERA, level)
    assert np.allclose(found.position, true.position, atol=1e-3)
    assert np.allclose(found.size, true.size, atol=1e-3)


def test_a_box_above_the_horizon_is_refused_by_name():
    with pytest.raises(SpecError, match=r"object thing.*horizon"):
        placed_box(
            _object(Box2D(x0=10, y0=5, x1=50, y1=20)), CAMERA.model_copy(update={"pitch": 0.0}), 0.0
        )


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kind": "cupboard"}, "kind"),
        ({"material": "mithril"}, "material"),
        ({"parent": "nothing"}, "parent"),
        ({"name": "../x"}, "name"),
        ({"name": GROUND}, "unique"),
        ({"parent": "thing"}, "cycle"),
    ],
)
def test_invalid_annotations_are_refused(fields, message):
    box = Box2D(x0=250, y0=150, x1=390, y1=330)
    with pytest.raises(ValidationError, match=message):
        Annotation(
            camera=CAMERA, objects=(AnnotatedObject(**{"name": "thing", "box": box} | fields),)
        )


def test_an_annotation_is_written_as_a_run_that_resumes(tmp_path, photo, quick_config):
    out = tmp_path / "out"
    write_annotated(photo, out, coffee(), quick_config, simulate=False)
    steps = json.loads((out / "run.json").read_text())["steps"]
    assert set(steps) == {"parse", "program/cup", "program/ground", "program/saucer"}
    # Reconstruct keeps both steps, so it asks no model.
    times = (out / "tree.json").stat().st_mtime_ns
    result = reconstruct(photo, out, quick_config, resume=True, until="program")
    assert result.objects == [GROUND, "saucer", "cup"]
    assert (out / "tree.json").stat().st_mtime_ns == times
    assert sum(row["calls"] for row in result.cost.get("by_role_and_model", [])) == 0
    # The annotation opens again as it was; objects can stay as they are.
    again = read_annotation(out)
    assert again == coffee()
    kept = again.model_copy(
        update={
            "objects": tuple(o.model_copy(update={"kind": EXISTING_PROGRAM}) for o in again.objects)
        }
    )
    before = (out / "objects" / "cup" / "program.py").read_text()
    write_annotated(photo, out, kept, quick_config, simulate=False)
    assert (out / "objects" / "cup" / "program.py").read_text() == before


def test_an_object_can_be_left_to_a_model(tmp_path, photo, quick_config):
    annotation = coffee(cup_kind=WRITTEN_BY_MODEL)
    out = tmp_path / "out"
    result = write_annotated(photo, out, annotation, quick_config)
    assert result.until == "parse"
    assert not (out / "objects" / "cup").exists()
    assert (out / "objects" / "saucer" / "program.py").is_file()


def test_a_parsed_tree_opens_as_an_annotation(tmp_path, photo, quick_config):
    parsed = tmp_path / "parsed"
    reconstruct(photo, parsed, quick_config, until="program")
    annotation = read_annotation(parsed)
    assert not (parsed / ANNOTATION).exists()
    assert {obj.name for obj in annotation.objects} == {"saucer", "cup", "spoon"}
    assert all(obj.kind == EXISTING_PROGRAM for obj in annotation.objects)
    tree = annotated_tree(annotation)
    assert annotation_from_tree(tree).objects == annotation.objects
    with pytest.raises(RunError, match="choose another kind"):
        write_annotated(photo, tmp_path / "new", annotation, quick_config)
    assert load_photo(photo).original_size == (tree.camera.width, tree.camera.height_px)

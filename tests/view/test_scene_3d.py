"""The interactive view of a report, in a real browser without a network."""

import io
import json
import math
import re

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.spec import SceneObject, SceneSpec
from neoworld_mjx.view.report import scene_3d
from neoworld_mjx.view.report.page import document
from tests.support import scenes
from tests.support.browser import changed, opened


def _scene(spec, state=None):
    obj = SceneObject(name="it", spec=spec, joint_state=state or {})
    table = SceneObject(name="table", spec=scenes.table(), environment=True, z=-0.05)
    return SceneSpec(name="scene", objects=(table, obj))


EYE = {"middle": [0, 0, 0.2], "azimuth": 0.4, "elevation": 0.4, "distance": 1.2, "fovy": 0.7}


def _write(path, scene, eye=None):
    """Write a page; with `eye`, the view starts there instead of at the scene's own viewpoint."""
    page = document("a page", [scene_3d.scene_3d(scene)], [scene_3d.script_hash()])
    if eye is not None:
        page = re.sub(r'"eye":\{[^}]*\}', f'"eye":{json.dumps(eye)}', page)
    path.write_text(page, encoding="utf-8")
    return f"file://{path}"


def _picture(page):
    with Image.open(io.BytesIO(page.page.locator("canvas").screenshot())) as image:
        return np.asarray(image.convert("RGB"))


def _slide(page, label, value):
    page.page.locator("label", has_text=label).locator("input").evaluate(
        "(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input')); }",
        value,
    )
    page.page.wait_for_timeout(300)


def _joints(spec):
    """Return positions of all joints that are not mimics, well inside their ranges."""
    state = {}
    for joint in spec.joints:
        if joint.type == "ball":
            state |= {f"{joint.name}.x": 0.2, f"{joint.name}.y": 0.5, f"{joint.name}.z": -0.1}
        elif joint.type in ("revolute", "prismatic") and joint.mimic is None:
            state[joint.name] = 0.6 * (joint.upper + joint.lower)
    return state


@pytest.mark.slow
@pytest.mark.parametrize("make", [scenes.cabinet, lambda: scenes.lamp().objects[-1].spec])
def test_sliders_pose_the_object_as_its_kinematics_do(tmp_path, make):
    spec = make()
    state = _joints(spec)
    assert state
    with opened(_write(tmp_path / "rest.html", _scene(spec), EYE), offline=True) as page:
        rest = _picture(page)
        for name, value in state.items():
            _slide(page, f"it: {name.replace('.', ' ')}", value)
        slid = _picture(page)
        page.page.locator("select").select_option("1")
        page.page.wait_for_timeout(300)
        alone = _picture(page)
        assert (page.errors, page.outside) == ([], [])
    with opened(_write(tmp_path / "posed.html", _scene(spec, state), EYE), offline=True) as page:
        posed = _picture(page)
    assert changed(rest, slid) > 0.001
    assert changed(posed, slid) < 1e-4
    assert changed(slid, alone) > 0.01, "the table is hidden"


def test_no_other_script_may_run_and_names_are_escaped():
    evil = scenes.cabinet().model_copy(update={"label": "</script><script>alert(1)</script>"})
    page = document("t", [scene_3d.scene_3d(_scene(evil))], [scene_3d.script_hash()])
    assert len(re.findall("<script", page)) == 2
    assert page.count(scene_3d.script()) == 1
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    assert policy is not None
    assert f"script-src {scene_3d.script_hash()}" in policy[1]
    assert "unsafe-eval" not in policy[1] and "default-src 'none'" in policy[1]
    assert scene_3d.script().count("\n") <= 250


def test_data_contain_every_triangle_and_joint():
    scene = scenes.furnished()
    data = scene_3d.scene_data(scene)
    json.dumps(data, allow_nan=False)
    for obj, drawn in zip(scene.objects, data["objects"], strict=True):
        assert [j["name"] for j in drawn["joints"]] == [j.name for j in obj.spec.joints]
        expected = sum(
            len(g.shape.surface()[1])
            for p in obj.spec.parts
            for g in p.geoms
            if g.role != "collision"
        )
        assert sum(m["triangles"] for part in drawn["parts"] for m in part) == expected
        for joint in drawn["joints"]:
            assert joint["low"] <= joint["high"] and math.isfinite(joint["high"])

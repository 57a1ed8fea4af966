"""Known sizes and poses: what the user knows of single objects, and no stage changes."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from neoworld_mjx.config import CEMOptions
from neoworld_mjx.errors import EvidenceError
from neoworld_mjx.estimate.align import align
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.known_objects import KnownObjects, KnownSize
from neoworld_mjx.pipeline.place import place
from neoworld_mjx.search.cem import initial_sigma
from neoworld_mjx.spec import PartState, bounds, world_poses
from tests.estimate import desk
from tests.support.furniture import chest
from tests.support.scenes import compile_scene


def size_of(item):
    low, high = bounds(item.spec, item.joint_state)
    return high - low


@pytest.fixture(scope="module")
def parsed(five):
    """The parse of the desk, in which every object is 6 % too large and 2 cm too far."""
    return desk.parsed(five, {o.name: 1.06 for o in five.objects if not o.environment}, ahead=0.02)


def placed(five, parsed, photo, known):
    objects = {item.name: item.spec for item in five.objects} | known.assets
    return place(parsed, objects, Evidence(photo, objects=known)).scene


def test_lengths_are_those_of_the_axes():
    assert KnownSize(height=0.1, diameter=0.08).edges == {"x": 0.08, "y": 0.08, "z": 0.1}
    assert KnownSize(width=0.3).edges == {"y": 0.3}
    assert KnownSize(width=0.3, height=0.12).phrase() == "height 0.12 m, width 0.3 m"
    for wrong in ({}, {"diameter": 0.1, "width": 0.1}, {"height": -1}, {"length": 0.1}):
        with pytest.raises(ValidationError):
            KnownSize(**wrong)


def test_a_box_gets_the_known_length_and_the_proportions_of_the_object(five, parsed):
    known = KnownObjects(sizes={"box": KnownSize(height=0.18)})
    tree = known.applied(parsed)
    before, after = parsed.node("box").box3d.size, tree.node("box").box3d.size
    assert after[2] == 0.18 and after[0] / before[0] == pytest.approx(0.18 / before[2])
    assert tree.node("box").cues.known_size == ("z",) and tree.node("can") == parsed.node("can")
    tree = known.applied(parsed, {"box": five.object("box").spec})
    assert np.allclose(tree.node("box").box3d.size, 2 * size_of(five.object("box")))
    two = KnownObjects(sizes={"box": KnownSize(height=0.18, width=0.05)})
    assert two.applied(parsed).node("box").box3d.size[1:] == (0.05, 0.18)
    tree = two.applied(parsed, {"box": five.object("box").spec})
    shape = np.divide(tree.node("box").box3d.size, size_of(five.object("box")))
    assert np.allclose(shape, shape[0])


def test_the_box_of_an_asset_has_its_open_parts(parsed):
    node = parsed.node("box")
    opened = PartState(part="drawer", type="prismatic", opening=1.0)
    opened = node.model_copy(update={"articulation": (opened,)})
    asset = KnownObjects(assets={"box": chest()})
    closed, open_ = (
        asset.applied(parsed.model_copy(update={"nodes": (parsed.node("desk"), n)})).node("box")
        for n in (node, opened)
    )
    low, high = bounds(chest())
    assert np.allclose(closed.box3d.size, high - low)
    assert open_.box3d.size[0] > closed.box3d.size[0] + 0.05


def test_every_stage_obeys_a_known_size(five, parsed, photo):
    known = KnownObjects(sizes={"can": KnownSize(height=0.11)})
    scene = placed(five, parsed, photo, known)
    assert size_of(scene.object("can")) == pytest.approx([0.0733, 0.0733, 0.11], abs=1e-4)
    assert scene.object("can").known == "size" and scene.object("box").known is None
    assert size_of(scene.object("box"))[2] != pytest.approx(0.09 * 1.06, abs=1e-4)
    deviation = scene.object("can").uncertainty.log_scale
    assert deviation < 1e-4 < scene.object("box").uncertainty.log_scale
    sigma = initial_sigma(compile_scene(scene).arrays, CEMOptions())
    can, box = scene.index("can"), scene.index("box")
    assert sigma.log_scale[0, can] == 0 and sigma.log_scale[0, box] > 0
    assert (sigma.xy[0, can] > 0).all()


def test_a_kept_object_stays_where_it_was_parsed(five, parsed, photo):
    scene = placed(five, parsed, photo, KnownObjects(keep=("can", "tower")))
    for name in ("can", "tower"):
        box = parsed.node(name).box3d
        pose = world_poses(scene)[name]
        assert np.allclose(pose.pos[:2], box.position[:2], atol=1e-6)
        assert scene.object(name).yaw == pytest.approx(box.yaw)
        assert np.allclose(size_of(scene.object(name)), box.size, rtol=1e-6)
    moved = world_poses(scene)["brick"].pos[:2] - parsed.node("brick").box3d.position[:2]
    assert math.hypot(*moved) > 0.005
    sigma = initial_sigma(compile_scene(scene).arrays, CEMOptions())
    assert not np.any([v[0, scene.index("can")].any() for v in (sigma.xy, sigma.yaw)])


def test_an_aligned_scene_keeps_what_is_known(five, photo):
    wrong = desk.displaced(five, can=(8, 0, 0, 6), box=(8, 0, 3, 4))
    objects = [
        item.model_copy(update={"known": {"can": "size", "box": "pose"}.get(item.name)})
        for item in wrong.objects
    ]
    scene = align(wrong.model_copy(update={"objects": tuple(objects)}), photo).scene
    assert scene.object("can").spec == wrong.object("can").spec
    assert scene.object("can").xy != wrong.object("can").xy
    assert scene.object("box").spec == wrong.object("box").spec
    assert np.allclose(scene.object("box").xy, wrong.object("box").xy, atol=1e-9)


@pytest.mark.parametrize(
    ("known", "message"),
    [
        ({"keep": ("cann",)}, "keep: no such object: got 'cann', valid are: box, can"),
        ({"sizes": {"desk": KnownSize(height=0.7)}}, "desk is a flat support of the environment"),
        (
            {"assets": {"cup": desk.can("a", 1, 1, "red")}},
            "objects: no such object: got 'cup'",
        ),
    ],
)
def test_wrong_names_are_refused_with_the_valid_ones(parsed, known, message):
    with pytest.raises(EvidenceError, match=message):
        KnownObjects(**known).check_names(parsed)

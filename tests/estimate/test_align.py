"""The alignment of rendered scenes: what comes back, and what does not move."""

import math

import numpy as np
import pytest

from neoworld_mjx.config import AlignOptions
from neoworld_mjx.errors import PhotoError
from neoworld_mjx.estimate import align as align_module
from neoworld_mjx.estimate.align import align, align_again, align_to_boxes
from neoworld_mjx.estimate.result import camera_change
from neoworld_mjx.spec import Sphere
from neoworld_mjx.spec.correlation import PoseCorrelation
from neoworld_mjx.spec.pose import from_axis_angle
from tests.estimate import desk

DISPLACED = {
    "box": (12.0, 0.0, 3.0, 2.0),
    "can": (-6.0, 10.4, 3.0, -2.0),
    "brick": (-6.0, -10.4, -3.0, 2.0),
    "ball": (0.0, 12.0, 3.0, -2.0),
    "tower": (0.0, -12.0, 3.0, 0.0),
}
"""By 12 mm, 3 deg and 2 %; with a mean of zero, as a photograph does not tell the scale of all."""


CONTOURS = AlignOptions(edges=False)
"""Contours alone: the vertical edges of so few objects move all of them together by some
millimeters, see test_camera_evidence."""


@pytest.fixture(scope="module")
def displaced(five):
    return desk.displaced(five, **DISPLACED)


@pytest.fixture(scope="module")
def aligned(displaced, photo):
    """The alignment of the displaced objects."""
    return align(displaced, photo, CONTOURS)


@pytest.fixture(scope="module")
def with_boxes(five):
    """The displaced objects with parsed boxes."""
    return desk.displaced(desk.boxed(five), **DISPLACED)


@pytest.fixture(scope="module")
def aligned_with_boxes(with_boxes, photo):
    return align(with_boxes, photo, CONTOURS)


@pytest.fixture(scope="module")
def on_black(five, photo):
    """The alignment with a black photograph."""
    return align(five, np.zeros_like(photo))


@pytest.fixture(scope="module")
def unmoved(five, photo):
    """The alignment of a scene that is right."""
    return align(five, photo, CONTOURS)


def many():
    """Nine objects, near and far, of which some are as long as a camera's view is deep."""
    return desk.on_desk(
        (desk.block("box", 0.1, 0.08, 0.09, "red"), (-0.3, 0.1), 0.3, {}),
        (desk.can("can", 0.04, 0.12, "blue"), (-0.05, -0.02), 0.0, {}),
        (desk.block("brick", 0.2, 0.07, 0.06, "green"), (-0.25, -0.12), -0.4, {}),
        (desk.colored("ball", Sphere(radius=0.045), "yellow"), (0.1, 0.15), 0.0, {}),
        (desk.block("tower", 0.06, 0.06, 0.16, "purple"), (0.15, -0.25), 0.2, {}),
        (desk.block("far", 0.08, 0.3, 0.1, "red"), (0.4, 0.2), 0.1, {}),
        (desk.block("plank", 0.5, 0.06, 0.03, "white"), (0.15, 0.02), 0.1, {}),
        (desk.block("tile", 0.3, 0.2, 0.02, "blue"), (0.25, -0.42), 0.0, {}),
        (desk.block("mat", 0.3, 0.2, 0.02, "green"), (0.0, 0.38), 0.0, {}),
    )


def with_thing(scene, spec, xy, yaw=0.0, **more):
    item = scene.objects[-1].model_copy(
        update={"name": spec.name, "spec": spec, "parent": "desk", "xy": xy, "yaw": yaw, **more}
    )
    return scene.model_copy(update={"objects": (*scene.objects, item.model_copy())})


def flat_photograph(scene, width=480):
    """Every object in one color, without light and shadows."""
    seen = desk.drawn(scene, width).owner
    names = [item.spec.materials[0].name for item in scene.objects] + ["white"]
    colors = np.array([desk.COLORS[name][:3] for name in names])
    return (255 * colors[seen] + 0.5).astype(np.uint8)


def test_boxes_bring_displaced_objects_back_in_the_picture(with_boxes, five):
    """A stack, too: what stands on a displaced object is where the picture shows it."""
    stack = desk.on_desk(
        (desk.block("low", 0.16, 0.16, 0.06, "red"), (-0.05, 0.1), 0.0, {}),
        (desk.can("high", 0.03, 0.1, "blue"), (0.0, 0.0), 0.0, {"parent": "low", "z": 0.06}),
        (desk.block("brick", 0.12, 0.07, 0.06, "green"), (-0.1, -0.2), -0.4, {}),
        (desk.block("tower", 0.06, 0.06, 0.16, "purple"), (0.15, -0.15), 0.2, {}),
    )
    moved = desk.displaced(desk.boxed(stack), low=(30, 40, 0, 0), high=(-25, -35, 0, 0))
    for truth, wrong, share in ((five, with_boxes, 0.7), (stack, moved, 0.5)):
        result = align_to_boxes(wrong)
        before, after = (desk.distances(scene, truth) for scene in (wrong, result.scene))
        assert np.mean([*after.values()]) < share * np.mean([*before.values()])
        # Boxes cannot tell a wrong field of view from wrong distances.
        assert result.scene.camera.fovy == wrong.camera.fovy
        assert result.scene.camera.roll == wrong.camera.roll
        assert all(item.uncertainty is None for item in result.scene.objects)
    assert after["high"] < 0.5 * before["high"]


def test_a_box_that_is_far_off_keeps_its_pull(five):
    """An object 15 cm off, whose box alone tells so."""
    wrong = desk.displaced(desk.boxed(five), can=(60.0, 140.0, 0, 0))
    after = desk.distances(align_to_boxes(wrong).scene, five)
    assert after["can"] < 40 and max(after.values()) < 40


def test_the_prior_is_about_the_parsed_places(five, photo):
    """Without evidence of the pixels, an object returns to where the parse has it."""
    parsed = desk.displaced(five, can=(20.0, -10.0, 5.0, 3.0))
    unknowns = desk.unknowns_of(five)
    again = unknowns.scene_at(unknowns.values_of(parsed))
    assert max(desk.distances(again, parsed).values()) < 0.5
    nothing = AlignOptions(contours=False, edges=False, contacts=False, camera=False)
    bare = tuple(item.model_copy(update={"box2d": None}) for item in five.objects)
    without = five.model_copy(update={"objects": bare})
    aligned = align(without, photo, nothing, parsed=parsed).scene
    assert max(desk.distances(aligned, parsed).values()) < 0.5


def test_displaced_objects_come_back(five, displaced, aligned):
    wrong, result = displaced, aligned
    before = desk.distances(wrong, five)
    assert list(before.values()) == pytest.approx([12.0] * 5, abs=0.5)
    after = desk.distances(result.scene, five)
    # What is left is mostly common to all, along the view, of which contours say least.
    assert np.mean(list(after.values())) < 12.0 / 3
    for name, distance in after.items():
        assert distance < 0.4 * before[name], (name, distance)
        assert result.objects[name].evidence == "pixels"
        assert result.objects[name].reason == ""
        assert result.objects[name].size_ratio == pytest.approx(
            1 / (1 + DISPLACED[name][3] / 100), abs=0.015
        )
    # The headings of boxes show; those of a can and a ball do not.
    turns = desk.turns(result.scene, five)
    assert max(turns["box"], turns["brick"]) < 1.0
    assert min(turns["can"], turns["ball"]) > 2.5
    # What the result reports is what the scene has.
    for name, change in result.objects.items():
        item, was = result.scene.object(name), wrong.object(name)
        assert np.add(was.xy, change.shift_m) == pytest.approx(item.xy)
        assert item.yaw - was.yaw == pytest.approx(math.radians(change.yaw_deg))
        assert item.uncertainty == change.uncertainty
        known = change.uncertainty.model_dump()
        assert (known["yaw"] is None) == (name in ("can", "ball"))
        assert min(value for value in known.values() if value is not None) > 0
    # The desk has no unknowns of its own; with the focal length the camera's distance changes.
    place = {"xy": wrong.object("desk").xy}
    assert result.scene.object("desk").model_copy(update=place) == wrong.object("desk")


def test_distances_are_correlated_with_sizes_and_with_each_other(aligned):
    """A farther object is larger; a camera that is higher moves all objects alike."""
    known = aligned.scene.correlation
    correlation = known.matrix()
    assert np.linalg.eigvalsh(correlation).min() > -1e-3  # four decimals are stored
    assert all(deviation > 0 for deviation in known.camera)
    along = [4 * (1 + k) for k in range(len(known.objects))]
    assert set(known.objects) == set(aligned.objects)
    assert all(correlation[row, row + 3] > 0.1 for row in along)
    between = correlation[np.ix_(along, along)][np.triu_indices(len(along), 1)]
    assert between.min() > 0.7
    again = PoseCorrelation.model_validate_json(known.model_dump_json())
    np.testing.assert_array_equal(again.matrix(), correlation)


@pytest.mark.parametrize("degrees", [12.0, pytest.param(-12.0, marks=pytest.mark.slow)])
def test_a_misjudged_field_of_view_comes_back(degrees):
    scene = many()
    wrong = desk.misjudged(scene, degrees)
    off = lambda s: math.degrees(s.camera.fovy - scene.camera.fovy)
    assert off(wrong) == pytest.approx(degrees)
    result = align(wrong, desk.photograph(scene))
    assert abs(off(result.scene)) < 4.0
    assert result.fovy_deg == pytest.approx(off(result.scene) - degrees)
    assert result.to_json()["fovy_deg"] == round(result.fovy_deg, 5)
    assert max(desk.distances(wrong, scene).values()) > 150
    assert max(desk.distances(result.scene, scene).values()) < 80
    line = camera_change(wrong.camera, result.scene.camera, [result])
    start, end = (math.degrees(s.camera.fovy) for s in (wrong, result.scene))
    assert line.startswith(f"field of view {start:.1f} -> {end:.1f} degrees")
    assert line.endswith("contours)") and "vertical edges" not in line.split("height")[0]


def test_a_scene_that_is_right_hardly_moves(five, photo, unmoved):
    boxed = desk.boxed(five)
    for result in (unmoved, align(boxed, photo, CONTOURS)):
        # All objects together are less certain along the view than to one another.
        assert max(desk.distances(result.scene, five).values()) < 5.0
        assert max(desk.distances(result.scene, five, common=False).values()) < 2.0
        assert {change.evidence for change in result.objects.values()} == {"pixels"}
        assert max(desk.turns(result.scene, five).values()) < 0.5
        changes = result.pitch_deg, result.roll_deg, result.fovy_deg
        assert max(map(abs, changes)) < 0.2 and abs(result.height_m) < 0.005
        assert list(result.notes()) == []


def test_a_camera_that_is_not_aligned_stays(five, photo, with_boxes, aligned_with_boxes):
    wrong = with_boxes
    result = align(wrong, photo, AlignOptions(camera=False))
    changes = result.pitch_deg, result.roll_deg, result.fovy_deg, result.height_m
    assert changes == (0.0, 0.0, 0.0, 0.0)
    was, now = (list(s.camera.model_dump().values()) for s in (wrong, result.scene))
    assert now == pytest.approx(was, abs=1e-12)
    assert now[-2:] == was[-2:]
    assert np.mean(list(desk.distances(result.scene, five).values())) < 4.0
    assert aligned_with_boxes.scene.camera != wrong.camera


def test_a_measured_parameter_of_the_camera_moves_less(five, photo):
    tilted = five.camera.model_copy(update={"pitch": five.camera.pitch + math.radians(1.5)})
    wrong = five.model_copy(update={"camera": tilted})
    free, measured = align(wrong, photo), align(wrong, photo, measured=("pitch", "height"))
    assert free.pitch_deg < measured.pitch_deg < 0
    assert free.pitch_deg == pytest.approx(-1.5, abs=0.75)


def test_without_contours_no_pixel_is_read(five, photo, displaced, with_boxes):
    wrong = with_boxes
    options = AlignOptions(contours=False)
    black = align(wrong, np.zeros_like(photo), options)
    result = align(wrong, photo, options)
    assert result.scene == black.scene and result.to_json() == black.to_json()
    assert {change.evidence for change in result.objects.values()} == {"box"}
    before, after = (desk.distances(s, five) for s in (wrong, result.scene))
    assert np.mean(list(after.values())) < 0.8 * np.mean(list(before.values()))
    # Nor is there anything else without boxes.
    nothing = align(displaced, photo, options)
    assert {change.evidence for change in nothing.objects.values()} == {"none"}
    assert max(abs(v) for c in nothing.objects.values() for v in c.shift_m) < 1e-12


def test_a_black_photograph_moves_nothing(five, photo, on_black):
    result = on_black
    composed = align(five, np.zeros_like(photo), AlignOptions(contours=False))
    assert max(desk.distances(result.scene, five).values()) < 1e-6
    for name, change in result.objects.items():
        known, prior = (c.uncertainty.model_dump() for c in (change, composed.objects[name]))
        yaw, prior_yaw = known.pop("yaw"), prior.pop("yaw")
        assert yaw is prior_yaw is None or yaw == pytest.approx(prior_yaw, rel=1e-6)
        assert known == pytest.approx(prior, rel=1e-6)


def test_a_round_object_has_a_heading_only_if_it_lies(five):
    lies = {"base_tilt": tuple(from_axis_angle((0.0, 1.0, 0.0), math.pi / 2)), "z": desk.TOP + 0.03}
    scene = desk.on_desk(
        (desk.can("lying", 0.03, 0.12, "blue"), (-0.05, 0.1), 0.6, lies),
        (desk.can("upright", 0.03, 0.12, "red"), (-0.05, -0.1), 0.6, {}),
        (desk.colored("ball", Sphere(radius=0.04), "yellow"), (0.15, 0.0), 0.0, lies),
    )
    turned = dict.fromkeys(("lying", "upright", "ball"), (0, 0, 4.0, 0))
    result = align(desk.displaced(scene, **turned), desk.photograph(scene, 640))
    left = desk.turns(result.scene, scene)
    assert left["lying"] < 1.0 and min(left["upright"], left["ball"]) > 3.9
    known = {name: change.uncertainty.yaw for name, change in result.objects.items()}
    assert known["upright"] is None and known["ball"] is None
    assert math.radians(0.15) < known["lying"] < math.radians(3)


def test_glass_keeps_its_composed_place(five):
    scene = with_thing(five, desk.can("glass", 0.03, 0.1, "clear"), (-0.25, 0.02))
    wrong = desk.displaced(scene, glass=(12.0, 0.0, 0.0, 2.0))
    photo = desk.photograph(scene)
    result = align(wrong, photo)
    assert result.objects["glass"].evidence == "none"
    assert result.objects["glass"].reason == "it is see-through"
    assert result.objects["glass"].shift_m == pytest.approx((0.0, 0.0), abs=1e-6)
    boxed = align(desk.boxed(wrong), photo).objects["glass"]
    assert (boxed.evidence, boxed.reason) == ("box", "it is see-through")
    assert boxed.uncertainty.across < result.objects["glass"].uncertainty.across


def test_factors_of_the_uncertainty_are_along_across_heading_and_size(aligned, monkeypatch):
    unknowns, k = aligned.fitted.unknowns, aligned.scene.index("box")
    placed = unknowns.place(aligned.fitted.x[None])[0]
    axes = unknowns.view_axes(placed, k)
    towards = placed.pos[k][:2] - placed.camera.position()[:2]
    assert abs(axes[0] @ towards) == pytest.approx(np.linalg.norm(towards), rel=1e-6)
    covariance = np.diag([0.0, 0.0, 0.04, 0.09])
    covariance[:2, :2] = axes.T @ np.diag([0.01**2, 0.02**2]) @ axes
    rows = np.zeros((4, unknowns.size))
    rows[:, unknowns.columns(k)] = covariance
    monkeypatch.setattr(align_module, "CALIBRATION", (3.0, 5.0, 7.0, 11.0))
    known = align_module._uncertainty(unknowns, placed, k, rows)
    assert (known.along, known.across) == pytest.approx((0.03, 0.1))
    assert (known.yaw, known.log_scale) == pytest.approx((1.4, 3.3))


def among_others(color):
    """A block on the desk with nothing behind it, next to others."""
    spec = desk.block("same", 0.1, 0.08, 0.05, color)
    return desk.on_desk(
        (desk.block("other", 0.1, 0.08, 0.05, "red"), (-0.05, 0.18), 0.3, {}),
        (desk.can("can", 0.04, 0.12, "blue"), (0.1, -0.02), 0.0, {}),
        (spec, (-0.1, -0.15), 0.2, {}),
    )


def test_an_object_of_its_background_s_color_keeps_its_place():
    scene = among_others("gray")
    wrong = desk.displaced(scene, same=(8.0, 6.0, 0.0, 0.0), other=(8.0, 6.0, 0.0, 0.0))
    result = align(wrong, flat_photograph(scene), CONTOURS)
    moved = desk.distances(result.scene, wrong)
    assert moved["same"] < 1.0
    assert moved["other"] > 6.0
    same, other = (result.objects[name].uncertainty for name in ("same", "other"))
    for name, value in same.model_dump().items():
        assert value > getattr(other, name)
    assert same.across > 4 * other.across
    # In another color it is found.
    colored = among_others("green")
    displaced = desk.displaced(colored, same=(8.0, 6.0, 0.0, 0.0))
    found = align(displaced, flat_photograph(colored), CONTOURS)
    assert desk.distances(found.scene, colored)["same"] < 3.5


@pytest.mark.parametrize(
    "xy",
    [(-0.2, 0.32), pytest.param((-0.42, -0.1), marks=pytest.mark.slow)],
    ids=["left", "below"],
)
def test_an_object_that_the_border_cuts_stays(five, xy):
    scene = with_thing(five, desk.block("cut", 0.2, 0.2, 0.1, "blue"), xy)
    shown = desk.drawn(scene, 320).owner == 6
    assert shown[:, 0].any() or shown[-1].any()
    photo, right = desk.photograph(scene), desk.boxed(scene)
    for wrong in (scene, desk.displaced(right, cut=(0.0, 12.0, 0.0, 0.0))):
        result = align(wrong, photo)
        assert desk.distances(result.scene, scene)["cut"] < 10.0
        assert result.objects["cut"].size_ratio == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("color", ["white", pytest.param("blue", marks=pytest.mark.slow)])
def test_a_cloth_does_not_push_what_stands_on_it(color):
    cloth = desk.block("cloth", 0.35, 0.35, 0.004, color)
    box = desk.block("on", 0.1, 0.1, 0.08, "red")
    scene = desk.on_desk(
        (cloth, (-0.05, 0.0), 0.0, {}),
        (box, (0.0, 0.0), 0.4, {"parent": "cloth", "z": 0.004}),
    )
    photo = desk.photograph(scene)
    for wrong in (scene, desk.displaced(scene, on=(8.0, 6.0, 0.0, 0.0))):
        after = align(wrong, photo).scene
        # In the frame of the cloth.
        assert 1000 * np.hypot(*after.object("on").xy) < 3.0
        assert desk.distances(after, scene)["on"] < 10.0
        assert desk.turns(after, scene)["on"] < 0.5


def test_scenes_without_a_camera_or_free_objects_are_returned(five, photo):
    blind = five.model_copy(update={"camera": None})
    assert align(blind, photo).scene is blind
    empty = desk.on_desk()
    result = align(empty, photo)
    assert result.scene is empty and result.objects == {}
    assert list(result.notes()) == []


def test_an_object_that_moves_far_is_noted(five, photo):
    wrong = desk.displaced(desk.boxed(five), brick=(0.0, 56.0, 0.0, 0.0))
    result = align(wrong, photo, CONTOURS)
    assert desk.distances(result.scene, five)["brick"] < 5.0
    ((which, reason),) = result.notes()
    assert which == "brick far from its composed pose"
    assert "moved it by 5." in reason


def test_a_photograph_of_another_aspect_ratio_is_refused(five, photo):
    with pytest.raises(PhotoError, match=r"640 x 240 pixels.* \(640 x 480\)"):
        align(five, photo[:240])


def test_aligning_some_objects_again_moves_nothing_else(displaced, five, photo):
    again = align_again(displaced, photo, ("box", "can"))
    assert set(again.objects) == {"box", "can"}
    assert again.scene.camera == displaced.camera
    for name in ("desk", "brick", "ball", "tower"):
        assert again.scene.object(name) == displaced.object(name)
    before, after = (desk.distances(scene, five) for scene in (displaced, again.scene))
    assert max(after[name] for name in ("box", "can")) < 3 < before["box"]

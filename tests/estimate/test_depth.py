"""Depth images and masks as evidence of the alignment of rendered scenes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from neoworld_mjx.config import AlignOptions
from neoworld_mjx.estimate.align import align, align_again, align_to_boxes
from neoworld_mjx.estimate.depth_start import place_by_depth, support_plane, with_measured_supports
from neoworld_mjx.estimate.rows.depth import MeasuredDepth, SceneDepth, measured_depth
from neoworld_mjx.estimate.unknowns import STEP, Unknowns
from neoworld_mjx.evidence.depth_image import DepthImage
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.known_camera import KnownCamera
from neoworld_mjx.evidence.masks import Masks
from neoworld_mjx.spec import SceneObject, world_poses
from tests.estimate import desk

DISPLACED = {
    "box": (40.0, 0.0, 3.0, 5.0),
    "can": (30.0, 10.4, 0.0, 3.0),
    "brick": (50.0, -10.4, -3.0, 4.0),
    "ball": (35.0, 12.0, 0.0, 2.0),
    "tower": (45.0, -12.0, 3.0, 5.0),
}
"""All of them too far and too large: what a photograph alone does not tell."""
KNOWN = KnownCamera(size=(640, 480), focal=desk.CAMERA.focal)


def depth_of(scene, width=640):
    values = desk.drawn(scene, width).depth
    return np.where(np.isfinite(values), values, np.nan)


def noisy(scene, seed=0):
    values = depth_of(scene)
    rng = np.random.default_rng(seed)
    values = values + rng.normal(size=values.shape) * (0.0015 + 0.002 * values**2)
    values[rng.random(values.shape) < 0.1] = np.nan
    return values


def depth_at_start(scene, image):
    unknowns = Unknowns.of(scene, scene.camera, rises=True)
    now = unknowns.place(np.zeros((1, unknowns.size)))[0]
    return unknowns, SceneDepth.of(image, None, unknowns, now, unknowns.draw(now, 320))


@pytest.fixture(scope="module")
def wrong(five):
    return desk.displaced(five, **DISPLACED)


@pytest.mark.parametrize("kind", ["metric", "affine", "disparity"])
def test_depth_of_every_kind_is_read_in_meters(five, kind):
    true = depth_of(five, 320)
    values = {"metric": true, "affine": (true - 0.3) / 2.7, "disparity": 3 / true + 0.2}[kind]
    measured = measured_depth(DepthImage(values, kind), desk.drawn(five, 320))
    known = np.isfinite(true)
    assert measured.depth[known] == pytest.approx(true[known], abs=1e-6)
    assert (measured.derivative is None) == (kind == "metric")


def test_derivatives_of_a_disparity_image_match_differences(five):
    """With respect to its scale and shift."""
    true = depth_of(five, 320)
    measured = measured_depth(DepthImage(3 / true + 0.2, "disparity"), desk.drawn(five, 320))
    known = np.isfinite(true)
    changed = 1 / (1 / true[known] + 1e-6)
    slope = (changed - true[known]) / 1e-6
    assert measured.derivative[known][:, 1] == pytest.approx(slope, rel=1e-4)


def test_jacobian_matches_the_change_of_residuals(five):
    image = DepthImage(depth_of(five, 320))
    unknowns, depth = depth_at_start(five, image)
    neighbors = unknowns.neighbors(np.zeros(unknowns.size))
    for name, column in (("box", 0), ("tower", 3)):
        k = five.index(name)
        rows = depth.evidence(neighbors, k, 0.1)
        pixels = depth.pixels(k)
        u = unknowns.columns(k).start + column
        size, local = 1e-4, []
        for x in (np.zeros(unknowns.size), size * np.eye(unknowns.size)[u]):
            place = unknowns.place(x[None])[0]
            row, col = pixels.row, pixels.column
            depths = depth.drawn.depth[row, col]
            points = depth.rays[row, col] * depths[:, None] @ depth.now.camera.axes().T
            body = depth.now.local(k, points + depth.now.camera.position())
            moved = (place.world(k, body) - place.camera.position()) @ place.camera.axes()
            local.append(np.sum(moved * pixels.normal, axis=1))
        slope = (local[1] - local[0]) / size
        assert rows.jacobian[:, u] == pytest.approx(slope, abs=20 * STEP)


def test_a_grown_object_deviates_like_one_that_is_as_large(five):
    image, k = DepthImage(depth_of(five, 320)), five.index("tower")
    grown = desk.displaced(five, tower=(0.0, 0.0, 0.0, 60.0))
    unknowns = desk.unknowns_of(five)
    x = unknowns.values_of(grown)
    now = unknowns.place(x[None])[0]
    depth = SceneDepth.of(image, None, unknowns, now, unknowns.draw(now, 320))
    again, written = depth_at_start(grown, image)
    expected = written.evidence(again.neighbors(np.zeros(again.size)), k, 0.1)
    found = depth.evidence(unknowns.neighbors(x), k, 0.1)
    assert found.weight == pytest.approx(expected.weight, rel=1e-6)


@pytest.mark.parametrize("kind", ["affine", "disparity"])
def test_rows_of_scale_and_shift_match_the_change_of_residuals(five, kind):
    true = depth_of(five, 320)
    unknowns, depth = depth_at_start(five, DepthImage(true if kind == "affine" else 1 / true, kind))
    k, step = five.index("box"), 1e-6
    rows = depth.evidence(unknowns.neighbors(np.zeros(unknowns.size)), k, 0.1)
    for column in (0, 1):
        values, derivative = depth.measured
        changed = MeasuredDepth(values + step * derivative[..., column], derivative)
        residual = replace(depth, measured=changed).pixels(k).residual
        slope = (residual - depth.pixels(k).residual) / step
        assert rows.global_jacobian[:, column] == pytest.approx(-slope, rel=1e-4, abs=1e-6)


@pytest.fixture(scope="module")
def plain(wrong, photo):
    """The alignment without the depth image."""
    return align(wrong, photo, evidence=Evidence(camera=KNOWN))


@pytest.fixture(scope="module")
def aligned(five, wrong, photo):
    """The alignment with a depth image of a sensor."""
    return align(wrong, photo, evidence=Evidence(camera=KNOWN, depth=DepthImage(noisy(five))))


def test_objects_come_to_their_measured_places(five, plain, aligned):
    """Within 4 mm, where the photograph alone leaves them 20 mm too far."""
    assert max(desk.distances(aligned.scene, five).values()) < 4.0
    assert max(desk.distances(plain.scene, five).values()) > 15.0
    outcome = aligned.objects["box"].depth
    assert outcome.after_m < 0.004 < outcome.before_m
    assert abs(outcome.rise_m) < 0.003


def test_places_by_depth_begin_the_estimate_by_boxes(five, wrong):
    """Boxes alone leave the distance of objects open that are too far and too large."""
    boxed = desk.boxed(five)
    far = [
        item.model_copy(update={"box2d": boxed.object(item.name).box2d}) for item in wrong.objects
    ]
    scene = wrong.model_copy(update={"objects": tuple(far)})
    alone = desk.distances(align_to_boxes(scene).scene, five)
    given = Evidence(camera=KNOWN, depth=DepthImage(noisy(five)))
    measured = desk.distances(align_to_boxes(scene, evidence=given).scene, five)
    assert np.mean([*measured.values()]) < 10 < np.mean([*alone.values()])


def test_boxes_use_the_roll_of_the_plane(five):
    """A response said 10 degrees of roll; by its boxes, objects at the border then were lost."""
    boxed = desk.boxed(five)
    rolled = boxed.model_copy(update={"camera": desk.CAMERA.model_copy(update={"roll": 0.17})})
    given = Evidence(camera=KNOWN, depth=DepthImage(noisy(five)))
    aligned = align_to_boxes(rolled, evidence=given).scene
    assert aligned.camera.roll == pytest.approx(desk.CAMERA.roll, abs=math.radians(0.5))
    assert align_to_boxes(rolled).scene.camera.roll == 0.17


def test_depth_narrows_the_uncertainty(plain, aligned):
    for name in DISPLACED:
        with_depth, without = (s.objects[name].uncertainty for s in (aligned, plain))
        assert with_depth.along < without.along / 2


def test_smooth_errors_of_a_network_do_not_pull_objects_away(five, photo):
    """A scene that is right stays within 12 mm; scale and shift are not known."""
    height, width = 480, 640
    waves = np.sin(np.arange(width) / 60)[None] * np.cos(np.arange(height) / 80)[:, None]
    values = depth_of(five) * (1 + 0.04 * waves)
    image = DepthImage((values - 0.3) / 2.7, "affine", smooth_sd=0.03)
    aligned = align(five, photo, evidence=Evidence(camera=KNOWN, depth=image))
    assert max(desk.distances(aligned.scene, five).values()) < 12.0


def test_plane_of_the_support_gives_pitch_roll_and_height(five):
    camera = desk.CAMERA.model_copy(update={"pitch": 0.62, "roll": 0.05, "height": 0.6})
    true = five.model_copy(update={"camera": camera})
    _, depth = depth_at_start(five, DepthImage(noisy(true)))
    plane = support_plane(depth)
    assert plane.pitch == pytest.approx(camera.pitch, abs=math.radians(0.2))
    assert plane.roll == pytest.approx(camera.roll, abs=math.radians(0.2))
    assert plane.height == pytest.approx(camera.height, abs=0.004)


def test_the_plane_turns_a_misjudged_camera(five, photo):
    """The plane's deviations are about the measured camera, not about the composed one."""
    tilted = {"pitch": desk.CAMERA.pitch + 0.03, "height": 1.05 * desk.CAMERA.height}
    camera = desk.CAMERA.model_copy(update=tilted)
    single = tuple(item for item in five.objects if item.parent is None or item.name == "tower")
    misjudged = five.model_copy(update={"camera": camera, "objects": single})
    evidence = Evidence(camera=KNOWN, depth=DepthImage(noisy(five)))
    found = align(misjudged, photo, evidence=evidence).scene.camera
    assert found.pitch == pytest.approx(desk.CAMERA.pitch, abs=math.radians(0.1))
    assert found.height == pytest.approx(desk.CAMERA.height, rel=0.005)


def test_objects_without_evidence_keep_their_place_before_the_camera(five, photo):
    """Not their place in the world, if depth turns the camera."""
    camera = desk.CAMERA.model_copy(update={"pitch": desk.CAMERA.pitch + 0.03})
    bare = tuple(item.model_copy(update={"box2d": None}) for item in five.objects)
    misjudged = five.model_copy(update={"camera": camera, "objects": bare})
    owner = desk.drawn(five, 640).owner
    support = np.where(
        np.isin(owner, [k for k, o in enumerate(bare) if o.static]), noisy(five), np.nan
    )
    evidence = Evidence(camera=KNOWN, depth=DepthImage(support))
    options = AlignOptions(contours=False, contacts=False)
    found = align(misjudged, photo, options, evidence=evidence).scene
    for name in ("box", "can", "brick"):
        seen = (world_poses(misjudged)[name].pos - camera.position()) @ camera.axes()
        expected = found.camera.position() + found.camera.axes() @ seen
        # The height is that of the support.
        assert world_poses(found)[name].pos[:2] == pytest.approx(expected[:2], abs=0.01)


def test_a_near_support_may_be_uneven_by_millimeters(five):
    """By waves of 7 mm, which are larger than the deviation of the sensor at this distance."""
    near = five.model_copy(update={"camera": desk.CAMERA.model_copy(update={"height": 0.25})})
    values = depth_of(near) * (1 + 0.007 / 0.25 * np.sin(np.arange(640) / 12))
    plane = support_plane(depth_at_start(near, DepthImage(values))[1])
    assert plane.height == pytest.approx(0.25, abs=0.002)


def test_no_plane_without_a_level_support(five):
    """A depth image of a wall in front of the camera."""
    wall = np.full((480, 640), 0.7)
    _, depth = depth_at_start(five, DepthImage(wall))
    assert support_plane(depth) is None


def test_known_camera_is_kept(five, photo, wrong):
    """Depth that contradicts a known pitch does not turn the camera."""
    c = desk.CAMERA
    known = replace(KNOWN, pitch=c.pitch, roll=c.roll, height=c.height)
    turned = five.model_copy(update={"camera": c.model_copy(update={"pitch": c.pitch + 0.05})})
    evidence = Evidence(camera=known, depth=DepthImage(depth_of(turned)))
    aligned = align(wrong, photo, evidence=evidence)
    assert aligned.scene.camera.pitch == pytest.approx(c.pitch, abs=0.01)
    assert aligned.scene.camera.height == pytest.approx(c.height, rel=0.01)


def test_height_above_a_missing_support_is_measured(five, photo):
    """An object on a book that the scene lacks is measured 30 mm above the desk."""
    items = [
        item.model_copy(update={"z": item.z + 0.03}) if item.name == "brick" else item
        for item in five.objects
    ]
    raised = five.model_copy(update={"objects": tuple(items)})
    picture = desk.photograph(raised, 640)
    image = DepthImage(noisy(raised))
    aligned = align(five, picture, evidence=Evidence(camera=KNOWN, depth=image))
    assert aligned.objects["brick"].depth.rise_m == pytest.approx(0.03, abs=0.005)
    assert abs(aligned.objects["tower"].depth.rise_m) < 0.005


def test_depth_of_something_else_is_not_taken_for_an_object(five, photo):
    """A hand in front of the box, which the photograph does not show."""
    values = depth_of(five)
    mask = desk.drawn(five, 640).owner == five.index("box")
    values[mask] = 0.4
    parsed = desk.boxed(five)
    aligned = align(parsed, photo, evidence=Evidence(camera=KNOWN, depth=DepthImage(values)))
    assert desk.distances(aligned.scene, five)["box"] < 5.0


def test_colors_do_not_overrule_a_sensor(five):
    """The photograph shows the can at another place than the sensor."""
    picture = desk.photograph(desk.displaced(five, can=(60.0, 40.0, 0.0, 0.0)))
    moved = desk.displaced(five, can=(25.0, 15.0, 0.0, 0.0))
    image = DepthImage(depth_of(five))
    aligned = align(moved, picture, evidence=Evidence(camera=KNOWN, depth=image))
    assert desk.distances(aligned.scene, five)["can"] < desk.distances(moved, five)["can"] / 2


@pytest.mark.parametrize("near", [False, True])
def test_object_far_off_starts_from_its_box(five, near):
    """Drawn where the photograph shows something else, its 2D box finds it."""
    moved, values = desk.displaced(desk.boxed(five), box=(150.0, -120.0, 0.0, 10.0)), depth_of(five)
    k = moved.index("box")
    values[(desk.drawn(five, 640).owner != k) & near] = 0.4
    _, depth = depth_at_start(moved, DepthImage(values))
    place = place_by_depth(depth, k)
    world = desk.CAMERA.position() + desk.CAMERA.axes() @ place.origin
    true = world_poses(five)["box"].pos
    assert np.linalg.norm((world - true)[:2]) < 0.03
    assert abs(math.log(place.ratio) + math.log(1.1)) < 0.15


@pytest.mark.parametrize("hidden", [False, True])
def test_an_object_starts_at_the_distance_of_what_its_box_shows(five, hidden):
    """Without a box, of all of it; the part beyond the box is hidden by something else."""
    values, k = 1.06 * depth_of(five), five.index("box")
    box = desk.boxed(five).objects[k].box2d
    x1, y1 = (round(a + 0.6 * (b - a)) for a, b in ((box.x0, box.x1), (box.y0, box.y1)))
    beyond = desk.drawn(five, 640).owner == k
    beyond[:y1, :x1] = False
    values[beyond & hidden] *= 1.3
    part = box.model_copy(update={"x1": x1, "y1": y1}) if hidden else None
    objects = list(five.objects)
    objects[k] = objects[k].model_copy(update={"box2d": part})
    scene = five.model_copy(update={"objects": tuple(objects)})
    place = place_by_depth(depth_at_start(scene, DepthImage(values))[1], k)
    offset = (world_poses(five)["box"].pos - desk.CAMERA.position()) @ desk.CAMERA.axes()
    assert place.ratio == pytest.approx(1.06, rel=5e-3)
    assert place.origin == pytest.approx(1.06 * offset, abs=0.005)


def test_wall_moves_to_its_measured_distance(five):
    wall = desk.block("wall", 0.05, 3.0, 2.0, "white")
    behind = SceneObject(name="wall", spec=wall, environment=True, xy=(1.6, 0.0), z=-0.5)
    truth = five.model_copy(update={"objects": (*five.objects, behind)})
    near = behind.model_copy(update={"xy": (1.45, 0.0)})
    scene = five.model_copy(update={"objects": (*five.objects, near)})
    _, depth = depth_at_start(scene, DepthImage(noisy(truth)))
    moved = with_measured_supports(scene, depth)
    assert moved.object("wall").xy == pytest.approx((1.6, 0.0), abs=0.01)
    assert moved.object("desk") == scene.object("desk")


def test_aligning_again_moves_no_support(five, photo):
    """A wall that is 10 cm too near stays where the search left it."""
    wall = desk.block("wall", 0.05, 3.0, 2.0, "white")
    behind = SceneObject(name="wall", spec=wall, environment=True, xy=(1.6, 0.0), z=-0.5)
    truth = five.model_copy(update={"objects": (*five.objects, behind)})
    near = behind.model_copy(update={"xy": (1.5, 0.0)})
    scene = five.model_copy(update={"objects": (*five.objects, near)})
    evidence = Evidence(camera=KNOWN, depth=DepthImage(noisy(truth)))
    again = align_again(scene, photo, {"box"}, evidence=evidence)
    assert again.scene.object("wall") == near
    assert again.scene.camera == scene.camera


def test_masks_replace_colors(five):
    """A gray photograph shows no contour; masks do."""
    moves = {"box": (12.0, 0.0, 3.0, 2.0), "brick": (-6.0, -10.4, -3.0, 2.0)}
    displaced = desk.displaced(five, **moves)
    gray = np.full((480, 640, 3), 128, np.uint8)
    owner = desk.drawn(five, 640).owner
    masks = Masks(owner + 1, {item.name: k + 1 for k, item in enumerate(five.objects)})
    options = AlignOptions(edges=False)
    plain = align(displaced, gray, options)
    masked = align(displaced, gray, options, evidence=Evidence(masks=masks))
    before, after = (desk.distances(a.scene, five, common=False) for a in (plain, masked))
    assert before["box"] > 8.0 and after["box"] < 4.0
    assert masked.objects["box"].evidence == "pixels"

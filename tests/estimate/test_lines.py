"""Straight edges of drawn pictures, and the camera that drawn posts determine."""

import math

import numpy as np
import pytest
from PIL import Image, ImageDraw

from neoworld_mjx.estimate.image.lines import EdgeRegion, line_segments, vertical_edges
from neoworld_mjx.spec import Box2D, Camera

SIZE = (240, 320)


def drawn(*lines, noise=0.0, finer=8, ink=(200, 60, 50)):
    """Fill half planes' borders: bands 20 px wide between two points each."""
    image = Image.new("RGB", (SIZE[1] * finer, SIZE[0] * finer), (90, 90, 90))
    draw = ImageDraw.Draw(image)
    for (x0, y0), (x1, y1) in lines:
        corners = [(x0, y0), (x1, y1), (x1 + 20, y1), (x0 + 20, y0)]
        draw.polygon([(finer * x, finer * y) for x, y in corners], fill=ink)
    pixels = np.array(image.resize((SIZE[1], SIZE[0]), Image.Resampling.BOX), float)
    pixels += noise * np.random.default_rng(0).normal(size=pixels.shape)
    return np.clip(np.rint(pixels), 0, 255).astype(np.uint8)


def upright(reach=15.0):
    return np.broadcast_to([0.0, 1.0], (*SIZE, 2)).copy(), math.radians(reach)


def degrees(segments):
    return np.degrees(np.arctan2(segments.direction[:, 0], segments.direction[:, 1]))


@pytest.mark.parametrize("noise", [0.0, 10.0])
def test_both_edges_of_a_band_are_found_where_they_are(noise):
    found = line_segments(drawn(((100, 40), (112, 200)), noise=noise), *upright())
    assert len(found.length) == 2
    slope = math.degrees(math.atan2(12, 160))
    assert degrees(found) == pytest.approx([slope] * 2, abs=0.3)
    # Of each edge by the row of its middle, as its ends are not sharp.
    right = found.middle[:, 0] - (found.middle[:, 1] - 40) * 12 / 160
    assert sorted(right) == pytest.approx([100, 120], abs=0.15)
    assert found.length == pytest.approx([160] * 2, rel=0.06)
    assert (np.abs(np.radians(degrees(found) - slope)) < 4 * found.sd + 1e-4).all()


def test_edges_that_point_elsewhere_are_not_found():
    rgb = drawn(((60, 120), (160, 60)))
    assert len(line_segments(rgb, *upright()).length) == 0
    along = np.broadcast_to([100.0, -60.0], (*SIZE, 2)).copy()
    assert len(line_segments(rgb, along, math.radians(15)).length) == 2


def test_pieces_of_one_line_are_joined_across_a_gap():
    whole = drawn(((100, 30), (110, 130)), ((112, 150), (118, 210)))
    found = line_segments(whole, *upright())
    assert len(found.length) == 2
    assert found.length == pytest.approx([180] * 2, rel=0.05)
    far = drawn(((100, 10), (101, 30)), ((111, 200), (112, 220)))
    assert len(line_segments(far, *upright()).length) == 4


def test_a_bent_edge_is_two_lines():
    found = line_segments(drawn(((100, 30), (112, 120)), ((112, 120), (100, 210))), *upright())
    slope = math.degrees(math.atan2(12, 90))
    assert sorted(degrees(found)) == pytest.approx([-slope] * 2 + [slope] * 2, abs=0.6)


def test_noise_alone_has_no_lines():
    noise = np.random.default_rng(0).normal(128, 20, (*SIZE, 3))
    found = line_segments(np.clip(noise, 0, 255).astype(np.uint8), *upright())
    assert len(found.length) == 0
    assert found.middle.shape == (0, 2)


CAMERA = Camera(
    width=640,
    height_px=480,
    fovy=math.radians(45.0),
    height=1.0,
    pitch=math.radians(28.0),
    roll=math.radians(2.0),
)
POSTS = ((1.4, 0.45), (1.8, 0.25), (1.3, 0.05), (2.0, -0.2), (1.5, -0.4))
"""Places of the posts on the ground [m]."""
EDGE_SD = math.radians(0.4)
"""Standard deviation of the angle of a vertical edge."""


def edges_of_posts(camera=CAMERA, places=POSTS):
    """Return the ends of both edges of each post, bottom first [px], shape [edge, 2, 2]."""
    ends = [[(x, y + side, z) for z in (0.0, 0.45)] for x, y in places for side in (-0.03, 0.03)]
    return camera.project(ends)[0]


@pytest.fixture(scope="module")
def posts():
    """A photograph of five posts, each 6 cm wide."""
    return photograph_of_posts(edges_of_posts())


def photograph_of_posts(edges):
    finer = 4
    image = Image.new("RGB", (finer * CAMERA.width, finer * CAMERA.height_px), (90, 90, 90))
    draw = ImageDraw.Draw(image)
    for left, right in edges.reshape(-1, 2, 2, 2):
        draw.polygon([tuple(finer * p) for p in (*left, *right[::-1])], fill=(200, 60, 50))
    return np.asarray(image.resize((CAMERA.width, CAMERA.height_px), Image.Resampling.BOX))


def stated(pitch_deg, roll_deg, camera=CAMERA):
    """Return a camera whose pitch and roll are off by some degrees."""
    off = {"pitch": math.radians(pitch_deg), "roll": math.radians(roll_deg)}
    return camera.model_copy(update={name: getattr(camera, name) + v for name, v in off.items()})


def residuals(camera, edges=None):
    """Return the angles between the edges and the vertical lines that a camera sees there."""
    bottom, top = np.moveaxis(edges_of_posts() if edges is None else edges, 1, 0)
    middle, edge = (bottom + top) / 2, bottom - top
    below = camera.position() + camera.rays(middle) - [0.0, 0.0, 1e-6]
    expected = camera.project(below)[0] - middle
    return np.arctan2(edge[:, 0], edge[:, 1]) - np.arctan2(expected[:, 0], expected[:, 1])


@pytest.mark.parametrize("off", [(0.0, 0.0), (5.0, -3.0), (-9.0, 5.0)])
def test_pitch_and_roll_are_the_least_squares_fit_of_the_edges(posts, off):
    found = vertical_edges(posts, stated(*off), [])
    assert found is not None and found.camera == stated(*off)
    assert math.degrees(found.pitch) == pytest.approx(28.0, abs=0.15)
    assert math.degrees(found.roll) == pytest.approx(2.0, abs=0.05)
    steps = ((0.01, 0.0), (0.0, 0.01))
    columns = [
        (residuals(stated(p, r)) - residuals(stated(-p, -r))) / math.radians(0.02) for p, r in steps
    ]
    information = np.stack(columns) @ np.stack(columns, axis=1) / EDGE_SD**2
    deviations = np.sqrt(np.diag(np.linalg.inv(information)))
    # The grid's step and the measured angles add a little.
    assert (found.pitch_sd, found.roll_sd) == pytest.approx(deviations, rel=0.15)
    # An edge of this direction is vertical, or one of those that point anywhere within 15 degrees.
    density = 1 / (EDGE_SD * math.sqrt(2 * math.pi))
    vertical = density / (density + 1 / (2 * math.radians(15.0)))
    assert found.count == pytest.approx(10 * vertical, rel=3e-3)


@pytest.mark.parametrize("off", [(0.0, 0.0), (0.0, 0.3), (0.9, 0.0), (-0.9, -0.2)])
def test_the_significance_is_that_of_the_edges_residuals(posts, off):
    found = vertical_edges(posts, stated(*off), [])
    assert found is not None
    chi = float(np.linalg.norm(residuals(stated(*off)) / EDGE_SD))
    assert found.sigma == pytest.approx(chi, rel=0.1, abs=0.3)


@pytest.mark.parametrize("off", [(0.0, 0.3), (0.5, 0.0), (-0.5, 0.0)])
def test_the_significance_counts_edges_that_lean_in_the_picture(off):
    """Seen from above at a wide angle, posts lean by 28 to 36 degrees."""
    view = {"pitch": math.radians(50.0), "fovy": math.radians(75.0), "roll": 0.0, "height": 1.2}
    camera = CAMERA.model_copy(update=view)
    edges = edges_of_posts(camera, ((0.5, 0.45), (0.5, -0.45), (0.8, 0.6), (0.8, -0.6)))
    wrong = stated(*off, camera)
    found = vertical_edges(photograph_of_posts(edges), wrong, [])
    assert found is not None
    chi = float(np.linalg.norm(residuals(wrong, edges) / EDGE_SD))
    assert found.sigma == pytest.approx(chi, rel=0.1)


def test_a_larger_photograph_is_reduced_to_its_whole_blocks(posts):
    """Of twice the size, and of a column and a row more, which fill no block of 2 x 2 pixels."""
    larger = np.pad(posts.repeat(2, axis=0).repeat(2, axis=1), ((0, 1), (0, 1), (0, 0)))
    assert vertical_edges(larger, stated(3.0, 1.0), []) == vertical_edges(
        posts, stated(3.0, 1.0), []
    )


def test_edges_vote_by_the_smallest_region_around_them(posts):
    whole = Box2D(x0=0.0, y0=0.0, x1=640.0, y1=480.0)
    half = Box2D(x0=0.0, y0=0.0, x1=320.0, y1=480.0)
    camera = stated(2.0, 1.0)

    def count(*regions):
        found = vertical_edges(posts, camera, regions)
        assert found is not None
        return found.count

    each = count() / 10
    # The edges of one object vote like six; those of the background, if one strip has as many.
    assert count(EdgeRegion(whole, True)) == pytest.approx(6 * each, rel=0.01)
    assert count(EdgeRegion(whole, True, background=True)) == pytest.approx(10 * each, rel=0.01)
    left = int((edges_of_posts()[:, :, 0].mean(axis=1) < 320).sum())
    assert 2 <= left <= 6
    within = (EdgeRegion(whole, False), EdgeRegion(half, True))
    assert count(*within) == count(*reversed(within)) == pytest.approx(left * each, rel=0.01)
    hidden = (EdgeRegion(whole, True), EdgeRegion(half, False))
    assert count(*hidden) == pytest.approx(min(10 - left, 6) * each, rel=0.01)
    (x0, y0), (x1, y1) = (
        edges_of_posts()[:2].reshape(-1, 2).min(0),
        edges_of_posts()[:2].max((0, 1)),
    )
    post = EdgeRegion(Box2D(x0=x0, y0=y0, x1=x1, y1=y1), True)
    assert count(EdgeRegion(whole, False), post) == pytest.approx(2 * each, rel=0.01)
    assert vertical_edges(posts, camera, [EdgeRegion(whole, False)]) is None

"""The prior: deviations of the camera and of places, and their tails."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from neoworld_mjx.estimate.prior import (
    ACROSS,
    DEPTH,
    FIXED_YAW,
    LOG_FOCAL,
    LOG_FOCAL_MISJUDGED,
    LOG_SIZE,
    LOG_STRETCH,
    MISJUDGED,
    PITCH,
    YAW,
    camera_deviations,
    is_misjudged,
    prior_precision,
)
from neoworld_mjx.estimate.unknowns import FOCAL, STRETCH, TILT
from neoworld_mjx.spec import HollowBox
from tests.estimate import desk


def precision(unknowns, x):
    now = unknowns.place(x[None])[0]
    return now, prior_precision(unknowns, now, x, camera_deviations((), {}, misjudged=False))


@pytest.mark.parametrize("deviation", [0.0, 0.05])
def test_a_field_of_view_is_misjudged_where_the_wider_part_of_its_prior_is_larger(deviation):
    offs = np.linspace(0.0, 0.3, 31)
    wide, narrow = (
        norm(scale=math.hypot(sd, deviation)).pdf(offs) for sd in (LOG_FOCAL_MISJUDGED, LOG_FOCAL)
    )
    expected = MISJUDGED * wide > (1 - MISJUDGED) * narrow
    assert [is_misjudged(off, deviation) for off in offs.tolist()] == expected.tolist()


def test_places_deviate_by_their_distance_along_and_across_the_view():
    scene = desk.five()
    unknowns = desk.unknowns_of(scene)
    now, prior = precision(unknowns, np.zeros(unknowns.size))
    assert prior.shape == (unknowns.size + STRETCH * 5,) * 2
    assert prior == pytest.approx(prior.T) and np.linalg.eigvalsh(prior).min() > 0
    for k in unknowns.free.tolist():
        own = unknowns.columns(k)
        covariance = np.linalg.inv(prior)[own, own]
        eye = now.camera.position()
        distance = np.linalg.norm(now.pos[k] - eye)
        away = (now.pos[k] - eye)[:2] / np.linalg.norm((now.pos[k] - eye)[:2])
        side = np.array([-away[1], away[0]])
        deviations = [math.sqrt(d @ covariance[:2, :2] @ d) / distance for d in (away, side)]
        assert deviations == pytest.approx([DEPTH, ACROSS])
        # The heading of what is round does not show.
        heading = FIXED_YAW if scene.objects[k].name in ("can", "ball") else YAW
        assert np.sqrt(np.diag(covariance)[2:]) == pytest.approx([heading, LOG_SIZE])
    assert np.diag(prior)[unknowns.size :] == pytest.approx(LOG_STRETCH**-2)


def test_tails_are_heavy():
    """Two deviations away, the prior is half as precise; that of the focal length is a Gaussian."""
    scene = desk.five()
    unknowns = desk.unknowns_of(scene)
    own, other = unknowns.columns(1), unknowns.columns(2)
    x = np.zeros(unknowns.size)
    now, before = precision(unknowns, x)
    along = unknowns.view_axes(now, 1)[0]
    x[own] = (*(2 * DEPTH * np.linalg.norm(now.pos[1] - now.camera.position()) * along), 2 * YAW, 0)
    x[TILT], x[FOCAL] = 2 * PITCH, 0.08
    # At the old placement, so that only the weights change.
    camera = camera_deviations((), {}, misjudged=False)
    after = prior_precision(unknowns, now, x, camera)
    assert after[own, own][:2, :2] == pytest.approx(before[own, own][:2, :2] / 2)
    assert after[own, own][2, 2] == pytest.approx(before[own, own][2, 2] / 2)
    assert after[own, own][3, 3] == before[own, own][3, 3]
    assert np.array_equal(after[other, other], before[other, other])
    assert after[TILT, TILT] == pytest.approx(before[TILT, TILT] / 2)
    assert after[FOCAL, FOCAL] == pytest.approx(1 / camera[FOCAL] ** 2)


def test_a_movable_support_limits_the_place():
    """By half the clearance in a container, and by a share of the shorter side on an object."""
    tray = desk.colored("tray", HollowBox(size=(0.12, 0.1, 0.05), wall=0.005), "white")
    block = desk.block("block", 0.08, 0.08, 0.04, "red")
    inside = {"parent": "tray", "z": 0.005}
    for relation, most in (("in", 0.01), ("on", 0.15 * 0.1), ("leaning", np.inf)):
        scene = desk.on_desk(
            (tray, (0, 0), 0.0, {}), (block, (0, 0), 0.0, {**inside, "relation": relation})
        )
        unknowns = desk.unknowns_of(scene)
        now, prior = precision(unknowns, np.zeros(unknowns.size))
        distance = np.linalg.norm(now.pos[2] - now.camera.position())
        expected = np.minimum(np.array([DEPTH, ACROSS]) * distance, most)
        own = prior[unknowns.columns(2), unknowns.columns(2)][:2, :2]
        assert np.sort(np.linalg.eigvalsh(own) ** -0.5) == pytest.approx(np.sort(expected))

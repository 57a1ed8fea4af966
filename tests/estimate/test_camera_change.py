"""One line says how the camera of a scene differs from that of the response, and from what."""

import math

from neoworld_mjx.estimate.result import Alignment, ObjectAlignment, camera_change
from neoworld_mjx.estimate.rows.edges import CameraEstimate
from neoworld_mjx.spec import Camera
from neoworld_mjx.spec.scene import PoseUncertainty
from tests.support import scenes


def camera(fovy_deg: float, height: float) -> Camera:
    """Return a camera that looks down by 20 degrees."""
    return Camera(
        width=640, height_px=480, fovy=math.radians(fovy_deg), height=height, pitch=math.radians(20)
    )


def aligned(**sources: str) -> Alignment:
    """Return an alignment whose camera has these sources, with one object seen in the pixels."""
    sure = PoseUncertainty(along=0.01, across=0.01, yaw=0.01, log_scale=0.01)
    return Alignment(
        scenes.coffee(),
        objects={"box": ObjectAlignment("pixels", "", (0.0, 0.0), 0.0, 1.0, sure)},
        camera={name: CameraEstimate(0.0, 0.1, source) for name, source in sources.items()},
    )


def test_a_replaced_camera_is_told_with_its_evidence():
    done = aligned(fovy="estimated: measured in the response", height="estimated: depth")
    assert camera_change(camera(25.3, 0.499), camera(19.1, 0.62), [done]) == (
        "field of view 25.3 -> 19.1 degrees, height 0.50 -> 0.62 m "
        "(estimated from: depth, contours)"
    )


def test_small_changes_and_known_parameters_are_not_told():
    done = aligned(fovy="estimated", height="camera.json")
    assert camera_change(camera(25.3, 0.5), camera(26.0, 0.62), [done]) == ""
    done = aligned(fovy="estimated", height="estimated")
    assert camera_change(camera(25.3, 0.5), camera(26.0, 0.501), [done]) == ""

"""Evidence about the camera from the vertical edges in the photograph; sources of its parameters.

The images of vertical edges meet at one point. It determines the camera's roll, and the ratio of
tan(pitch) to the focal length.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from ...evidence.evidence import Evidence
from ...render.rasterize import WorldMesh
from ...spec import Box2D, Camera
from ..image.lines import EdgeRegion, VerticalEdges, vertical_edges
from ..unknowns import CAMERA, FOCAL, ROLL, TILT, Unknowns

LEAST_PITCH, LEAST_ROLL = math.radians(0.5), math.radians(0.3)
"""Least standard deviations of the estimated pitch and roll [rad], because the edges of one object,
and those of one lens, tend to be wrong together."""
UPRIGHT = math.sin(math.radians(1.0))
"""Largest vertical component of the unit normal of a vertical face, and largest horizontal
component of that of a horizontal face."""
LEAST_SHARE = 0.03
"""Least second moment of the normals of an object's vertical faces, along any horizontal direction,
relative to the object's area. Below it, the object is flat, or its vertical faces have only
one direction and thus meet in no vertical edge."""


def edges_of_photo(
    unknowns: Unknowns,
    x: Float[np.ndarray, " u"],
    photo: UInt8[np.ndarray, "row column 3"],
) -> VerticalEdges | None:
    """Estimate pitch and roll from vertical edges, at a given focal length.

    Edges in the 2D box of an object without vertical edges do not count.

    Args:
        unknowns: the unknowns.
        x: values of the unknowns, which determine the focal length. Edges count if their directions
            are close to those expected at these values.
        photo: the photograph (sRGB).

    Returns:
        The estimate; None if there are fewer than two edges.
    """
    place = unknowns.place(x[None])[0]
    camera = place.camera
    regions = []
    for k, item in enumerate(unknowns.scene.objects):
        mesh = unknowns.mesh(place, k)
        box = item.box2d
        if box is None:
            pixels, depth = camera.project(mesh.vertices)
            pixels = pixels[depth > 0]
            if not len(pixels) or not np.all(np.ptp(pixels, axis=0) > 0):
                continue
            low, high = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
            box = Box2D(x0=low[0], y0=low[1], x1=high[0], y1=high[1])
        # Lines on a table, such as its grain, are not vertical; those on a wall may be.
        vertical = not is_flat(mesh) if item.environment else has_vertical_edges(mesh)
        regions.append(EdgeRegion(box, vertical, item.environment))
    return vertical_edges(photo, camera, regions)


def has_vertical_edges(mesh: WorldMesh) -> bool:
    """Return whether vertical faces of at least two directions bound an object.

    These are the faces of an upright box, and the side of an upright cylinder.
    """
    normals, area = _normals(mesh)
    vertical = np.abs(normals[:, 2]) < UPRIGHT
    across = normals[vertical, :2]
    moments = across.T @ (across * area[vertical, None])
    return float(np.linalg.eigvalsh(moments)[0]) > LEAST_SHARE * float(area.sum())


def is_flat(mesh: WorldMesh) -> bool:
    """Return whether most of a surface is horizontal, as that of a table or a floor."""
    normals, area = _normals(mesh)
    horizontal = np.hypot(normals[:, 0], normals[:, 1]) < UPRIGHT
    return float(area[horizontal].sum()) > float(area.sum()) / 2


def _normals(mesh: WorldMesh) -> tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, " t"]]:
    """Return the unit normals and areas of the triangles that are not degenerate."""
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    wide = area > 0
    return normals[wide] / area[wide, None], area[wide] / 2


def linearized_edges(
    edges: VerticalEdges, unknowns: Unknowns, x: Float[np.ndarray, " u"]
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 4"]]:
    """Return residuals and Jacobian of an estimate by vertical edges, in standard deviations.

    Args:
        edges: the estimate.
        unknowns: the unknowns.
        x: values of the unknowns.

    Returns:
        Estimate minus expectation of pitch and roll, and the derivatives of the expectation with
        respect to the unknowns of the camera.
    """
    camera, _ = unknowns.camera_at(x)
    # The point of the vertical edges is f / tan(pitch) below the middle of the picture.
    shorter = edges.camera.focal / camera.focal
    tangent = math.tan(camera.pitch) * shorter
    expected = np.array([math.atan(tangent), camera.roll])
    jacobian = np.zeros((2, CAMERA))
    jacobian[0, TILT] = shorter / math.cos(camera.pitch) ** 2 / (1 + tangent**2)
    jacobian[0, FOCAL] = -tangent / (1 + tangent**2)
    jacobian[1, ROLL] = 1.0
    deviations = edge_deviations(edges)
    residual = (np.array([edges.pitch, edges.roll]) - expected) / deviations
    return residual, jacobian / deviations[:, None]


def edge_deviations(edges: VerticalEdges) -> Float[np.ndarray, " 2"]:
    """Return the standard deviations of pitch and roll of an estimate by vertical edges [rad]."""
    return np.array([max(edges.pitch_sd, LEAST_PITCH), max(edges.roll_sd, LEAST_ROLL)])


ESTIMATED, MEASURED = "estimated", "measured in the response"
"""Source of a camera parameter that is not known, and of one that the response measured."""


@dataclass(frozen=True)
class CameraEstimate:
    """One parameter of the camera after the alignment."""

    value: float
    """[rad], or [m] for the height."""
    deviation: float
    """Standard deviation, in the unit of `value`; not calibrated."""
    source: str
    """Source of the value."""


def camera_estimates(
    camera: Camera,
    deviations: Float[np.ndarray, " 4"],
    evidence: Evidence,
    *,
    measured: Collection[str],
    edges: bool,
) -> dict[str, CameraEstimate]:
    """Return pitch, roll, fovy and height of an aligned camera, with their sources.

    Args:
        camera: the camera.
        deviations: standard deviations of pitch, roll, log focal length and log height.
        evidence: known camera and depth image.
        measured: parameters that the response measured, as in `SceneTree.camera_measured`.
        edges: True if vertical edges were used.
    """
    units = {"pitch": 1.0, "roll": 1.0, "fovy": math.sin(camera.fovy), "height": camera.height}
    known = {} if evidence.camera is None else evidence.camera.deviations()
    metric = evidence.depth is not None and evidence.depth.kind == "metric"
    estimates = {}
    for (name, unit), deviation in zip(units.items(), deviations.tolist(), strict=True):
        parameter = "focal" if name == "fovy" else name
        if evidence.camera is not None and parameter in known:
            source = evidence.camera.source_of(parameter)
        else:
            from_photo = {
                MEASURED: name in measured,
                "vertical edges": edges and name in ("pitch", "roll"),
                "depth": metric and name != "fovy",
            }
            used = ", ".join(phrase for phrase, holds in from_photo.items() if holds)
            source = f"{ESTIMATED}: {used}" if used else ESTIMATED
        value = float(getattr(camera, name))
        estimates[name] = CameraEstimate(value, abs(unit) * deviation, source)
    return estimates

"""Problem of the alignment: its evidence, its start, and its equations at some values."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, UInt8

from ..config import AlignOptions
from ..evidence.evidence import Evidence
from ..render.rasterize import DrawnObjects
from ..spec import Box2D, SceneSpec
from .depth_start import (
    MeasuredPlace,
    SupportPlane,
    moved_to,
    place_by_depth,
    support_plane,
    with_measured_supports,
    with_places_kept,
)
from .image.colors import LabImage
from .image.lines import PITCH_RANGE, ROLL_RANGE, VerticalEdges
from .prior import camera_deviations, edges_mislead, prior_precision
from .result import DepthOutcome
from .rows.boxes import box_evidence
from .rows.contacts import ContactGaps, SceneGeoms, contacts
from .rows.contours import contour_evidence
from .rows.depth import SceneDepth
from .rows.edges import edge_deviations, edges_of_photo, linearized_edges
from .rows.linear import LinearEvidence, combined
from .rows.standing import Standing
from .solve import NormalEquations
from .unknowns import Unknowns

CAMERA_NAMES = ("pitch", "roll", "focal", "height")
"""Names of the camera's unknowns, in their order."""
COARSE_PX, FINE_PX = 320, 640
"""Widths of the coarse and the fine image [px]."""
PLANE_DEVIATIONS = {"pitch": math.radians(0.3), "roll": math.radians(0.3), "height": 0.01}
"""Standard deviations of the camera by the plane of a support: angles [rad], and log height. Flat
objects on the support tilt the plane by up to .8 degrees; the noise of a sensor by .1."""


@dataclass(frozen=True)
class AlignmentStage:
    """A number of Gauss-Newton steps with the same settings."""

    steps: int
    width: int
    """Width of the image [px]."""
    reach: float = 0.0
    """Largest displacement of a contour, in pixels of an image REFERENCE_PX wide; if 0, only 2D
    boxes are used."""
    spacing: float = 0.0
    """Distance between samples along a normal, in pixels of an image REFERENCE_PX wide."""
    local_colors: bool = False
    """If True, use the colors near each point of a contour, too."""
    depth_reach: float = 0.02
    """Residual of a depth at which its weight is quartered [m]."""
    open_focal: bool = False
    """If True, use the wide prior of the focal length, and estimate after each step whether the
    field of view is misjudged."""


@dataclass(frozen=True)
class AlignmentProblem:
    """Unknowns, options and evidence of an alignment, and the equations at some values."""

    unknowns: Unknowns
    options: AlignOptions
    measured_camera: frozenset[str]
    """Camera parameters that the response measured."""
    stated_camera: Mapping[str, float]
    """Standard deviations that the response states, as `SceneTree.camera_deviations`."""
    colliders: SceneGeoms | None
    """Collision geoms of the scene; None if objects may overlap."""
    standing: Standing | None
    """Objects that stay over their supports; None if objects need not."""
    evidence: Evidence = field(default_factory=Evidence)
    """Known camera, depth image and masks."""
    misjudged: bool = True
    """True if the field of view is or may be misjudged."""
    edges: VerticalEdges | None = None
    """Estimate of pitch and roll from vertical edges; None if there are no such edges."""
    misleading_edges: bool = False
    """True if there are edges that are probably not vertical, see `edges_mislead`."""
    mean: Float[np.ndarray, " u"] | None = None
    """Mean of the prior; None for the composed scene."""
    plane: SupportPlane | None = None
    """Camera by the plane of a support; None without metric depth or such a plane."""
    boxes_only: bool = False
    """True if 2D boxes are the only evidence."""

    @property
    def uses_edges(self) -> bool:
        """True if vertical edges are evidence about the camera."""
        return self.options.camera and self.options.contours and self.options.edges

    def start(self) -> Float[np.ndarray, " u"]:
        """Return initial values: the composed scene, or every object at its measured place.

        The plane of a support locates the camera first. Objects follow, parents first; those that
        the depth image does not show keep their places before the camera.
        """
        if self.evidence.depth is None:
            return self.camera_start()
        first = self.depth_at(np.zeros(self.unknowns.size))
        seen = (lambda _: None) if self.plane is None else self._before_camera()
        return self._with_objects(lambda k: place_by_depth(first, k) or seen(k))

    def prior_mean(self, parsed: SceneSpec | None = None) -> Float[np.ndarray, " u"]:
        """Return the mean of the prior: the parsed places, if the plane of no support is measured.

        A measured plane turns the camera. Objects then keep their composed horizontal places before
        it, on their supports: they were composed from the picture.

        Args:
            parsed: the objects at their parsed places; by default, those of the composed scene.
        """
        if self.plane is None:
            if parsed is None:
                return self.camera_start()
            return self.unknowns.values_of(parsed)
        return self._with_objects(self._before_camera())

    def _before_camera(self) -> Callable[[int], MeasuredPlace | None]:
        """Return a function from objects to their composed places in the camera's frame."""
        now = self.unknowns.place(np.zeros((1, self.unknowns.size)))[0]
        seen = (now.pos - now.camera.position()) @ now.camera.axes()
        return lambda k: MeasuredPlace(seen[k], 1.0)

    def _with_objects(
        self, place_of: Callable[[int], MeasuredPlace | None]
    ) -> Float[np.ndarray, " u"]:
        unknowns, x = self.unknowns, self.camera_start()
        level = unknowns.arrangement.ancestors.sum(axis=1)
        for k in sorted(unknowns.free.tolist(), key=lambda k: (level[k], k)):
            place = place_of(k)
            if place is not None and not unknowns.in_wall[k].any():
                x[unknowns.columns(k)] = moved_to(unknowns, place, k, x)
        x[list(unknowns.known)] = 0.0
        return x

    def camera_start(self) -> Float[np.ndarray, " u"]:
        """Return the composed scene with the camera by the plane, where it is not known."""
        x = np.zeros(self.unknowns.size)
        if self.plane is None:
            return x
        known = {} if self.evidence.camera is None else self.evidence.camera.deviations()
        now = self.unknowns.camera
        changes = {
            "pitch": self.plane.pitch - now.pitch,
            "roll": self.plane.roll - now.roll,
            "height": math.log(self.plane.height / now.height),
        }
        for name, change in changes.items():
            if name not in known:
                x[CAMERA_NAMES.index(name)] = change
        return x

    def measured(
        self, unknowns_of: Callable[[SceneSpec], Unknowns], *, supports: bool
    ) -> "AlignmentProblem":
        """Return the problem with the camera and, if asked, the supports that a depth image shows.

        Without metric depth, the problem is returned unchanged.

        Args:
            unknowns_of: function that returns the unknowns of a scene.
            supports: if True, walls and raised supports move to their measured places.
        """
        image = self.evidence.depth
        if image is None or image.kind != "metric":
            return self
        first = self.depth_at(np.zeros(self.unknowns.size))
        plane = support_plane(first) if self.options.camera else None
        problem = replace(self, plane=plane)
        if not supports:
            return problem
        x = problem.camera_start()
        scene = with_places_kept(self.unknowns.scene, first, self.unknowns.camera_at(x)[0])
        problem = replace(problem, unknowns=unknowns_of(scene))
        # The plane is kept: the moved supports would change what it was estimated from.
        scene = with_measured_supports(scene, problem.depth_at(x))
        return replace(problem, unknowns=unknowns_of(scene))

    def depth_outcomes(self, x: Float[np.ndarray, " u"]) -> dict[int, DepthOutcome]:
        """Return what the depth image says of each free object at `x`, by index."""
        if self.evidence.depth is None:
            return {}
        unknowns = self.unknowns
        before, after = (self.depth_at(values) for values in (np.zeros_like(x), x))
        found = {}
        for k in unknowns.free.tolist():
            first, last = before.pixels(k), after.pixels(k)
            if last is None:
                continue
            rise = sum(x[u] for u in unknowns.rise_columns(k))
            start = last if first is None else first
            was, now = (float(np.median(np.abs(pixels.residual))) for pixels in (start, last))
            found[k] = DepthOutcome(len(last.residual), was, now, float(rise))
        return found

    def depth_at(self, x: Float[np.ndarray, " u"]) -> SceneDepth:
        """Return the measured depth of the scene rendered at `x`."""
        now = self.unknowns.place(x[None])[0]
        drawn = self.unknowns.draw(now, COARSE_PX)
        assert self.evidence.depth is not None
        return SceneDepth.of(self.evidence.depth, self.evidence.masks, self.unknowns, now, drawn)

    def linearized(
        self,
        x: Float[np.ndarray, " u"],
        images: Sequence[LabImage | None],
        stage: AlignmentStage,
        silent: Collection[int],
    ) -> NormalEquations:
        """Return the normal equations at `x`.

        Args:
            x: values of the unknowns.
            images: the photograph at the stage's width, and the further ones; None if only boxes
                are used.
            stage: settings of the Gauss-Newton steps.
            silent: indices of the objects whose contours are ignored.
        """
        unknowns = self.unknowns
        now, neighbors = unknowns.place(x[None])[0], unknowns.neighbors(x)
        drawn = unknowns.draw(now, stage.width)
        depth = None
        if self.evidence.depth is not None:
            depth = SceneDepth.of(self.evidence.depth, self.evidence.masks, unknowns, now, drawn)
        mean = np.zeros_like(x) if self.mean is None else self.mean
        equations = NormalEquations(
            unknowns,
            prior_precision(
                unknowns,
                now,
                x - mean,
                self.camera_deviations(),
                boxes_only=self.boxes_only,
                pitch_known="pitch" in self.known_camera(),
            ),
            x,
            mean=mean,
            global_count=0 if depth is None else depth.global_count,
        )
        if self.edges is not None:
            equations.add_camera(*linearized_edges(self.edges, unknowns, x))
        gaps = [] if self.colliders is None else [*contacts(self.colliders, unknowns, now)]
        if self.standing is not None:
            gaps += self.standing.insets(unknowns, now)
        if gaps:
            equations.add_contacts(ContactGaps.of(gaps, unknowns, now, neighbors))
        if depth is not None:
            for k in range(len(unknowns.scene.objects)):
                rows = depth.evidence(neighbors, k, stage.depth_reach)
                if rows is not None:
                    equations.add("depth", k, rows)
        masks = self.masks_at(drawn)
        boxes: Mapping[str, Box2D | None]
        boxes = {item.name: item.box2d for item in unknowns.scene.objects}
        all_boxes = [boxes, *(view.photo.boxes for view in unknowns.views)]
        places = [
            (now.seen_from(number), [place.seen_from(number) for place in neighbors])
            for number in range(len(images))
        ]
        rendered = [drawn, *(unknowns.draw(here, stage.width) for here, _ in places[1:])]
        for k in unknowns.free.tolist():
            name, contours = unknowns.scene.objects[k].name, list[LinearEvidence]()
            for (here, near), seen, boxes, image in zip(
                places, rendered, all_boxes, images, strict=True
            ):
                box = box_evidence(
                    unknowns, here, near, seen, k, boxes.get(name), soft=stage.reach == 0
                )
                if box is not None:
                    equations.add("box", k, box)
                if image is None or stage.reach == 0 or k in silent:
                    continue
                contour = contour_evidence(
                    unknowns,
                    here,
                    near,
                    seen,
                    image,
                    k,
                    reach=stage.reach,
                    step=stage.spacing,
                    local_colors=stage.local_colors,
                    known=None if here.view else masks.get(k),
                )
                if contour is not None:
                    contours.append(contour)
            if contours:
                equations.add("contour", k, combined(contours))
        return equations

    def masks_at(self, drawn: DrawnObjects) -> dict[int, Bool[np.ndarray, "row column"]]:
        """Return the known masks at the size of a rendering, by index of the object."""
        if self.evidence.masks is None:
            return {}
        names = [item.name for item in self.unknowns.scene.objects]
        return self.evidence.masks.at(names, *drawn.owner.shape)

    def with_edges(
        self, x: Float[np.ndarray, " u"], photo: UInt8[np.ndarray, "row column 3"]
    ) -> "AlignmentProblem":
        """Return the problem with the vertical edges of a photograph, found with the camera at `x`.

        Without edges, it has none; neither if they probably mislead, which only a camera shows
        whose pitch and field of view are known or measured: any other may be far off.
        """
        edges, known = edges_of_photo(self.unknowns, x, photo), self.known_camera()
        sure = all(
            name in known or parameter in self.measured_camera
            for name, parameter in (("pitch", "pitch"), ("focal", "fovy"))
        )
        if edges is None or not sure:
            return replace(self, edges=edges)
        mean = np.zeros_like(x) if self.mean is None else self.mean
        spans = 2 * np.array([PITCH_RANGE, ROLL_RANGE]) / edge_deviations(edges)
        rows = linearized_edges(edges, self.unknowns, mean)
        misled = edges_mislead(*rows, self.camera_deviations(), spans)
        return replace(self, edges=None if misled else edges, misleading_edges=misled)

    def camera_deviations(self) -> Float[np.ndarray, " 4"]:
        """Return the prior standard deviations of the camera's unknowns."""
        known, stated = self.known_camera(), self.stated_camera
        return camera_deviations(self.measured_camera, known, stated, misjudged=self.misjudged)

    def known_camera(self) -> dict[str, float]:
        """Return the standard deviations of what the user or a measured plane determines."""
        known = {} if self.plane is None else PLANE_DEVIATIONS
        given = {} if self.evidence.camera is None else self.evidence.camera.deviations()
        return known | given

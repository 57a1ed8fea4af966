"""Align a composed scene with the photograph: camera and layout together, by Gauss-Newton steps.

The evidence consists of the contours of all objects in the photograph, from coarse to fine
resolution, of its vertical edges, and of the parsed 2D boxes. The prior is the composed scene.
Contacts keep objects from overlapping. An object without contour evidence stays near its composed
pose, and its 2D box keeps it in place in the image if the camera moves.
"""

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ..config import AlignOptions
from ..errors import PhotoError
from ..evidence.evidence import Evidence
from ..physics.photo_view import see_through
from ..spec import SceneSpec
from ..spec.scene import PoseUncertainty
from .alignment import (
    Alignment,
    DepthOutcome,
    EvidenceKind,
    FittedUnknowns,
    JointAlignment,
    ObjectAlignment,
    camera_deviations,
    is_misjudged,
    opening_deviation,
    prior_precision,
)
from .camera_evidence import camera_estimates, edges_of_photo, linearized_edges
from .colors import LabImage, is_supported, overlap, shown_at
from .contacts import SceneGeoms, contacts
from .depth_rows import SceneDepth
from .depth_start import (
    moved_to,
    place_by_depth,
    support_plane,
    with_measured_supports,
    with_places_kept,
)
from .image_lines import VerticalEdges
from .normal_equations import NormalEquations, Source, box_evidence, contour_evidence
from .rasterize import DrawnObjects, height_of
from .unknowns import CAMERA, FOCAL, Placement, Unknowns

SAME_ASPECT = 0.02
"""Difference between the logarithms of two aspect ratios up to which they count as equal."""
COARSE_PX, FINE_PX = 320, 640
"""Widths of the coarse and the fine image [px]."""
NO_CONTOUR = "no visible contour has different colors on its two sides"
"""Reason reported for objects without contour evidence."""
PLANE_DEVIATIONS = {"pitch": math.radians(0.1), "roll": math.radians(0.1), "height": 0.003}
"""Standard deviations of the camera by the plane of a support: angles [rad], and log height."""
CONTRADICTED = "the place that it suggests contradicts the object's colors or mask"
"""Reason reported for objects whose depth is not used."""
SAME_OVERLAP = 0.01
"""Difference of intersections over union with a known mask up to which they count as equal."""
CALIBRATION = (1.85, 2.0, 1.1, 1.6)
"""Factors that multiply the standard deviations along the view, across the view, of the heading and
of the log scale. They were set on the development half of the benchmark scenes. `neoworld
bench run coverage` counts the 90 % intervals that contain the true value."""


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


STAGES = (
    AlignmentStage(2, COARSE_PX, open_focal=True, depth_reach=0.1),
    AlignmentStage(2, COARSE_PX, 16.0, 1.5, open_focal=True, depth_reach=0.06),
    AlignmentStage(2, FINE_PX, 10.0, 1.0, open_focal=True, depth_reach=0.03),
    AlignmentStage(2, FINE_PX, 6.0, 0.5, local_colors=True),
)
STAGES_AGAIN = (
    AlignmentStage(2, FINE_PX, 10.0, 1.0),
    AlignmentStage(1, FINE_PX, 6.0, 0.5, local_colors=True),
)
"""Stages of an alignment that starts from an aligned scene."""


def align(
    scene: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    options: AlignOptions | None = None,
    *,
    measured: Collection[str] = (),
    evidence: Evidence | None = None,
) -> Alignment:
    """Align a composed scene with its photograph.

    If the solver fails, the composed scene is returned, with the reason in `Alignment.failure`.

    Args:
        scene: the composed scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
        options: which unknowns are estimated, and which evidence is used.
        measured: camera parameters that the response measured, as in `SceneTree.camera_measured`.
            Their prior is narrower, but they still move if the contours clearly contradict them.
        evidence: known camera, depth image and masks; its photograph is not used. The scene's
            camera must have the known values.

    Returns:
        The aligned scene, with its camera and each object's uncertainty. If the scene has no
        camera, or if no object is free to move, the scene is returned unchanged.

    Raises:
        PhotoError: the photograph does not have the camera's aspect ratio.
    """
    o = options or AlignOptions()
    known = evidence or Evidence()
    return _aligned(scene, photo, o, STAGES, measured=frozenset(measured), evidence=known)


def align_again(
    scene: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    only: Collection[str],
    options: AlignOptions | None = None,
    *,
    evidence: Evidence | None = None,
) -> Alignment:
    """Align some objects of an aligned scene once more; all others and the camera keep their poses.

    Args:
        scene: the scene, with a camera.
        photo: the photograph (sRGB), at any size of the camera's aspect ratio.
        only: names of the objects that may move.
        options: as for `align`. Joints keep their positions.
        evidence: depth image and masks.

    Returns:
        The alignment. Its uncertainties do not include that of the camera.

    Raises:
        PhotoError: the photograph does not have the camera's aspect ratio.
    """
    o = (options or AlignOptions()).model_copy(update={"camera": False, "joints": False})
    return _aligned(scene, photo, o, STAGES_AGAIN, only=only, evidence=evidence or Evidence())


def _aligned(
    scene: SceneSpec,
    photo: UInt8[np.ndarray, "row column 3"],
    o: AlignOptions,
    stages: Sequence[AlignmentStage],
    *,
    evidence: Evidence,
    measured: frozenset[str] = frozenset(),
    only: Collection[str] | None = None,
) -> Alignment:
    camera = scene.camera
    if camera is None:
        return Alignment(scene)
    aspect = photo.shape[1] * camera.height_px / (photo.shape[0] * camera.width)
    if abs(math.log(aspect)) > SAME_ASPECT:
        size = f"{photo.shape[1]} x {photo.shape[0]}"
        raise PhotoError(
            f"the photograph has {size} pixels, which is not the aspect ratio of the scene's "
            f"camera ({camera.width} x {camera.height_px})"
        )
    rises = evidence.depth is not None
    make = partial(
        Unknowns.of, camera=camera, joints=o.joints and o.contours, only=only, rises=rises
    )
    unknowns = make(scene)
    if not len(unknowns.free):
        return Alignment(scene)
    if evidence.depth is not None and evidence.depth.kind == "metric":
        rough = _Problem(unknowns, o, measured, None, evidence)
        x = rough.camera_start()
        first, after = rough.depth_at(np.zeros_like(x)), unknowns.camera_at(x)[0]
        unknowns = make(with_places_kept(scene, first, after))
        moved = replace(rough, unknowns=unknowns).depth_at(x)
        # The camera stays as estimated: moved supports would change what it is estimated from.
        unknowns = make(with_measured_supports(unknowns.scene, moved))
    widths = {stage.width for stage in stages}
    images = {w: LabImage.of(photo, w, height_of(camera, w)) for w in widths}
    colliders = SceneGeoms.of(scene, unknowns.parts) if o.contacts else None
    problem = _Problem(unknowns, o, measured, colliders, evidence)
    try:
        return _solution(problem, photo, images, stages)
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        return Alignment(scene, failure=f"the solver failed: {str(error).splitlines()[0]}")


def _solution(
    problem: "_Problem",
    photo: UInt8[np.ndarray, "row column 3"],
    images: dict[int, LabImage],
    stages: Sequence[AlignmentStage],
) -> Alignment:
    unknowns, scene = problem.unknowns, problem.unknowns.scene
    reasons = {
        k: "it is see-through" for k, item in enumerate(scene.objects) if see_through(item.spec)
    }
    if not problem.options.contours:
        reasons = dict.fromkeys(range(len(scene.objects)), "contours are disabled")
    x = problem.start()
    if problem.evidence.depth is not None and problem.evidence.depth.kind == "metric":
        by_plane = bool(x[:CAMERA].any())
        problem = replace(problem, mean=x.copy(), by_plane=by_plane)
    misjudged = True
    for width, of_width in itertools.groupby(stages, lambda stage: stage.width):
        if problem.uses_edges:
            # Only edges that are almost vertical for the current camera count.
            problem = replace(problem, edges=edges_of_photo(unknowns, x, photo))
        for stage in of_width:
            problem = replace(problem, misjudged=misjudged or stage.open_focal)
            for _ in range(stage.steps):
                equations, _ = problem.linearized(x, images[width], stage, reasons)
                x = problem.solved(equations)
                if stage.open_focal:
                    deviation = math.sqrt(equations.covariance()[FOCAL, FOCAL])
                    misjudged = is_misjudged(float(x[FOCAL]), deviation)
    last = stages[-1]
    equations, drawn = problem.linearized(x, images[last.width], last, reasons)
    x = problem.solved(equations)
    contradicted: frozenset[int] = frozenset()
    sources: tuple[Source, ...] = ("contour", "depth")
    for source in sources if problem.evidence.depth is not None else sources[:1]:
        refused = problem.refused(equations, drawn, images[last.width].bins, source)
        if not refused:
            continue
        if source == "contour":
            reason = "its colors do not distinguish it from its surroundings"
            reasons |= dict.fromkeys(refused, reason)
        else:
            contradicted = frozenset(refused)
            problem = replace(problem, without_depth=contradicted)
        reset = equations.solved(without=refused, source=source)
        for k in refused:
            own = unknowns.own_columns(k)
            x[own] = reset[own]
        for _ in range(last.steps):
            equations, drawn = problem.linearized(x, images[last.width], last, reasons)
            x = problem.solved(equations)
    closed = problem.refused_joints(equations, drawn, images[last.width].bins)
    if closed:
        problem = replace(problem, held=closed)
        for _ in range(last.steps):
            equations, _ = problem.linearized(x, images[last.width], last, reasons)
            x = problem.solved(equations)
    outcomes = problem.depth_outcomes(x, contradicted)
    return _result(problem, x, equations, reasons, outcomes)


@dataclass(frozen=True)
class _Problem:
    unknowns: Unknowns
    options: AlignOptions
    measured: frozenset[str]
    colliders: SceneGeoms | None
    """Collision geoms of the scene; None if objects may overlap."""
    evidence: Evidence = field(default_factory=Evidence)
    """Known camera, depth image and masks."""
    misjudged: bool = True
    """True if the field of view is or may be misjudged."""
    edges: VerticalEdges | None = None
    """Estimate of pitch and roll from vertical edges; None if there are no such edges."""
    mean: Float[np.ndarray, " u"] | None = None
    """Mean of the prior; None if it is the composed scene."""
    by_plane: bool = False
    """True if the plane of a support determines the mean of the camera's pitch, roll and height."""
    without_depth: frozenset[int] = frozenset()
    """Indices of the objects whose depth is ignored."""
    held: frozenset[int] = frozenset()
    """Indices of the open joints that keep their composed positions."""

    @property
    def uses_edges(self) -> bool:
        """True if vertical edges are evidence about the camera."""
        return self.options.camera and self.options.contours and self.options.edges

    def start(self) -> Float[np.ndarray, " u"]:
        """Return initial values: the composed scene, or every object at its measured distance.

        With metric depth, fixed supports locate the camera first. Objects follow, parents first.
        """
        unknowns, image = self.unknowns, self.evidence.depth
        x = np.zeros(unknowns.size)
        if image is None:
            return x
        first = self.depth_at(x)
        x[:CAMERA] = self.camera_by_depth(x)
        level = unknowns.arrangement.ancestors.sum(axis=1)
        for k in sorted(unknowns.free.tolist(), key=lambda k: (level[k], k)):
            place = place_by_depth(first, k)
            if place is not None and not unknowns.in_wall[k].any():
                x[unknowns.columns(k)] = moved_to(unknowns, place, k, x)
        return x

    def camera_start(self) -> Float[np.ndarray, " u"]:
        """Return the composed scene, with the camera by depth."""
        x = np.zeros(self.unknowns.size)
        x[:CAMERA] = self.camera_by_depth(x)
        return x

    def camera_by_depth(self, x: Float[np.ndarray, " u"]) -> Float[np.ndarray, " 4"]:
        """Return the camera's unknowns by the plane of the largest support.

        They are those of `x` without metric depth, without such a plane, and where they are known.
        """
        found, image = x[:CAMERA].copy(), self.evidence.depth
        if image is None or image.kind != "metric" or not self.options.camera:
            return found
        plane = support_plane(self.depth_at(x))
        if plane is None:
            return found
        known = {} if self.evidence.camera is None else self.evidence.camera.deviations()
        now, _ = self.unknowns.camera_at(x)
        pitch, roll = plane.pitch - now.pitch, plane.roll - now.roll
        log_height = math.log(plane.height / now.height)
        for column, (name, change) in enumerate(
            (("pitch", pitch), ("roll", roll), ("focal", 0.0), ("height", log_height))
        ):
            if name not in known:
                found[column] += change
        return found

    def depth_outcomes(
        self, x: Float[np.ndarray, " u"], refused: Collection[int]
    ) -> dict[int, DepthOutcome]:
        """Return what the depth image says of each free object, by index.

        Args:
            x: values of the unknowns after the alignment.
            refused: indices of the objects whose depth was not used.
        """
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
            reason = CONTRADICTED if k in refused else ""
            found[k] = DepthOutcome(len(last.residual), was, now, float(rise), reason)
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
        image: LabImage,
        stage: AlignmentStage,
        silent: Collection[int],
    ) -> tuple[NormalEquations, DrawnObjects]:
        """Return the normal equations at `x`, and the objects rendered at `x`.

        Args:
            x: values of the unknowns.
            image: the photograph at the stage's width.
            stage: settings of the Gauss-Newton steps.
            silent: indices of the objects whose contours are ignored.
        """
        unknowns = self.unknowns
        now, neighbors = unknowns.place(x[None])[0], unknowns.neighbors(x)
        drawn = unknowns.draw(now, stage.width)
        depth = None
        if self.evidence.depth is not None:
            depth = SceneDepth.of(self.evidence.depth, self.evidence.masks, unknowns, now, drawn)
        equations = NormalEquations(
            unknowns,
            prior_precision(
                unknowns, now, x if self.mean is None else x - self.mean, self.camera_deviations()
            ),
            x,
            mean=self.mean,
            global_count=0 if depth is None else depth.global_count,
        )
        if self.edges is not None:
            equations.add_camera(*linearized_edges(self.edges, unknowns, x))
        if self.colliders is not None:
            equations.add_contacts(contacts(self.colliders, unknowns, now, neighbors))
        if depth is not None:
            for k in range(len(unknowns.scene.objects)):
                rows = depth.evidence(neighbors, k, stage.depth_reach)
                if rows is not None and k not in self.without_depth:
                    equations.add_depth(k, rows)
        masks = self.masks_at(drawn)
        for k in unknowns.free.tolist():
            box = box_evidence(unknowns, now, neighbors, drawn, k)
            if box is not None:
                equations.add_box(k, box)
            if stage.reach == 0 or k in silent:
                continue
            contour = contour_evidence(
                unknowns,
                now,
                neighbors,
                drawn,
                image,
                k,
                reach=stage.reach,
                step=stage.spacing,
                local_colors=stage.local_colors,
                known=masks.get(k),
            )
            if contour is not None:
                equations.add_contour(k, contour)
        return equations, drawn

    def masks_at(self, drawn: DrawnObjects) -> dict[int, Bool[np.ndarray, "row column"]]:
        """Return the known masks at the size of a rendering, by index of the object."""
        if self.evidence.masks is None:
            return {}
        names = [item.name for item in self.unknowns.scene.objects]
        return self.evidence.masks.at(names, *drawn.owner.shape)

    def camera_deviations(self) -> Float[np.ndarray, " 4"]:
        """Return the prior standard deviations of the camera's unknowns."""
        if not self.options.camera:
            return np.full(CAMERA, 1e-9)
        known = PLANE_DEVIATIONS if self.by_plane else {}
        if self.evidence.camera is not None:
            known = known | self.evidence.camera.deviations()
        return camera_deviations(self.measured, known, misjudged=self.misjudged)

    def solved(self, equations: NormalEquations) -> Float[np.ndarray, " u"]:
        """Return new values of the unknowns; those of the camera are 0 if it is not estimated."""
        x = equations.solved(held=self.as_composed(equations))
        if not self.options.camera:
            x[:CAMERA] = 0.0
        return x

    def as_composed(self, equations: NormalEquations) -> dict[int, float]:
        """Return the value 0 for the unknown of each joint that keeps its composed position.

        These are the joints in `held` and all joints of objects without contour evidence.
        """
        first = self.unknowns.first_joint
        return {
            first + j: 0.0
            for j, joint in enumerate(self.unknowns.joints)
            if j in self.held or joint.object not in equations.with_contour
        }

    def refused_joints(
        self,
        equations: NormalEquations,
        drawn: DrawnObjects,
        bins: Int[np.ndarray, "row column"],
    ) -> frozenset[int]:
        """Return the joints whose changes make their objects fit the photograph less well."""
        unknowns, held = self.unknowns, self.as_composed(equations)
        now = unknowns.place(equations.solved(held=held)[None])[0]
        refused = []
        for j, joint in enumerate(unknowns.joints):
            u = unknowns.first_joint + j
            if u in held:
                continue
            other = unknowns.place(equations.solved(held=held | {u: 0.0})[None])[0]
            moved, composed = (
                shown_at(unknowns, place, drawn, joint.object) for place in (now, other)
            )
            if not is_supported(moved, composed, bins):
                refused.append(j)
        return frozenset(refused)

    def refused(
        self,
        equations: NormalEquations,
        drawn: DrawnObjects,
        bins: Int[np.ndarray, "row column"],
        source: Source = "contour",
    ) -> tuple[int, ...]:
        """Return the objects whose colors contradict the evidence of a source.

        They fit the photograph less well with this evidence than without.
        """
        unknowns = self.unknowns
        held = self.as_composed(equations)
        now = unknowns.place(equations.solved(held=held)[None])[0]
        refused = []
        masks = self.masks_at(drawn)
        used = equations.with_contour if source == "contour" else equations.with_depth
        for k in (k for k in used if k in unknowns.free):
            still = held | dict.fromkeys(unknowns.joint_columns(k), 0.0)
            other = unknowns.place(equations.solved(without=(k,), held=still, source=source)[None])[
                0
            ]
            with_it, without = (shown_at(unknowns, place, drawn, k) for place in (now, other))
            known = masks.get(k)
            if known is None:
                supported = is_supported(with_it, without, bins)
            else:
                supported = overlap(with_it, known) >= overlap(without, known) - SAME_OVERLAP
            if not supported:
                refused.append(k)
        return tuple(refused)


def _result(
    problem: _Problem,
    x: Float[np.ndarray, " u"],
    equations: NormalEquations,
    reasons: dict[int, str],
    depths: dict[int, DepthOutcome],
) -> Alignment:
    unknowns, composed = problem.unknowns, problem.as_composed(equations)
    scene = unknowns.scene_at(x)
    before, after = unknowns.camera, scene.camera
    assert after is not None
    covariance = equations.covariance()
    now = unknowns.place(x[None])[0]
    objects, items = {}, list(scene.objects)
    for k in unknowns.free.tolist():
        entries = x[unknowns.columns(k)]
        evidence: EvidenceKind = "box" if k in equations.with_box else "none"
        if k in equations.with_contour:
            evidence = "pixels"
        reason = "" if evidence == "pixels" else reasons.get(k, NO_CONTOUR)
        joints = _joints(unknowns, scene, k, covariance, composed)
        known = {name: joint.deviation for name, joint in joints.items()}
        uncertainty = _uncertainty(unknowns, now, k, covariance[unknowns.columns(k)], known)
        items[k] = items[k].model_copy(update={"uncertainty": uncertainty})
        shift = (float(entries[0]), float(entries[1]))
        objects[items[k].name] = ObjectAlignment(
            evidence,
            reason,
            shift,
            math.degrees(entries[2]),
            math.exp(entries[3]),
            uncertainty,
            joints,
            depths.get(k),
        )
    return Alignment(
        scene.model_copy(update={"objects": tuple(items)}),
        math.degrees(after.pitch - before.pitch),
        math.degrees(after.roll - before.roll),
        math.degrees(after.fovy - before.fovy),
        after.height - before.height,
        objects,
        camera_estimates(
            after,
            np.sqrt(np.diag(covariance)[:CAMERA]),
            problem.evidence,
            measured=problem.measured,
            edges=problem.edges is not None,
        ),
        fitted=FittedUnknowns(unknowns, x, equations.shape_evidence()),
    )


def _joints(
    unknowns: Unknowns,
    scene: SceneSpec,
    k: int,
    covariance: Float[np.ndarray, "u u"],
    composed: Collection[int],
) -> dict[str, JointAlignment]:
    """Return the changes of an object's open joints; the unknowns in `composed` did not change."""
    found = {}
    for u in unknowns.joint_columns(k):
        joint = unknowns.joints[u - unknowns.first_joint]
        slides = scene.objects[k].spec.joint(joint.name).type == "prismatic"
        value, change = scene.objects[k].joint_state[joint.name], 0.0
        deviation = opening_deviation(joint)
        if u not in composed:
            change = (value - joint.value) * math.copysign(1.0, joint.value)
            deviation = math.sqrt(covariance[u, u])
        found[joint.name] = JointAlignment(slides, value, change, deviation)
    return found


def _uncertainty(
    unknowns: Unknowns,
    now: Placement,
    k: int,
    rows: Float[np.ndarray, "4 u"],
    joints: dict[str, float],
) -> PoseUncertainty:
    """Return the calibrated standard deviations of an object, given its rows of the covariance."""
    block = rows[:, unknowns.columns(k)]
    axes = unknowns.view_axes(now, k)
    along, across = np.sqrt(np.diag(axes @ block[:2, :2] @ axes.T))
    if unknowns.in_wall[k].any():
        # The wall determines the distance, so it has no deviation along the view.
        along, across = 0.0, math.sqrt(block[0, 0])
    yaw, log_scale = np.sqrt(np.diag(block)[2:])
    along, across, yaw, log_scale = (
        np.array([along, across, yaw, log_scale]) * CALIBRATION
    ).tolist()
    if unknowns.round[k] and not unknowns.in_wall[k].any():
        yaw = None
    return PoseUncertainty(along=along, across=across, yaw=yaw, log_scale=log_scale, joints=joints)

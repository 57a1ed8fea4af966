"""Functions that create the shapes of a program.

Sizes are full lengths in meters. A sandboxed program may pass values of any type, so `validate`
checks every argument. `no_type_check` prevents other run-time type checkers from raising first.

Points at which a program repeats a shape: grids, rings and mirror images.
"""

import math
from collections.abc import Sequence
from typing import Any, Literal, no_type_check

import numpy as np

from .. import spec as S
from ..spec.primitives import MAX_SECTORS, MIN_SECTORS
from . import session as validate
from .part import Face, Point2, Shape, Vec3
from .session import current

Point3 = tuple[float, float, float]

MAX_POINTS = 64
MAX_SHAPE_PIECES = 1200
_CATMULL_ROM = np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2
"""Weights of four successive points (columns) for each power of the curve parameter (rows)."""
_FACES = ("+x", "-x", "+y", "-y", "+z", "-z")


@no_type_check
def box(size: Vec3) -> Shape:
    """Make a box with full edge lengths (x, y, z), centered at the origin."""
    return make_shape(S.Box, 1, size=validate.lengths(size, "box size"))


@no_type_check
def sphere(radius: float) -> Shape:
    """Make a ball, centered at the origin."""
    return make_shape(S.Sphere, 1, radius=validate.length(radius, "sphere radius"))


@no_type_check
def capsule(radius: float, length: float) -> Shape:
    """Make a capsule along z, centered at the origin; `length` excludes the round ends."""
    return make_shape(S.Capsule, 1, **_lengths("capsule", radius=radius, length=length))


@no_type_check
def cylinder(radius: float, height: float) -> Shape:
    """Make a solid cylinder along z, centered at the origin."""
    return make_shape(S.Cylinder, 1, **_lengths("cylinder", radius=radius, height=height))


@no_type_check
def ellipsoid(radii: Vec3) -> Shape:
    """Make an ellipsoid with semi-axes (x, y, z), centered at the origin."""
    return make_shape(S.Ellipsoid, 1, radii=validate.lengths(radii, "ellipsoid radii"))


@no_type_check
def prism(outline: Sequence[Point2], height: float) -> Shape:
    """Extrude a convex outline of (x, y) points along z from -height/2 to height/2."""
    points = validate.points(outline, "prism outline", 3, MAX_POINTS)
    return make_shape(S.Prism, 1, outline=points, height=validate.length(height, "prism height"))


@no_type_check
def hollow_box(size: Vec3, wall: float, open: Face | Sequence[Face] = "+z") -> Shape:
    """Make a hollow box, centered at the origin; the faces in `open` have no wall."""
    faces = [open] if isinstance(open, str) else validate.sequence(open, "hollow_box open", 0, 5)
    for face in faces:
        if face not in _FACES:
            raise ValueError(
                f"hollow_box open takes faces {', '.join(_FACES)}, got {validate.formatted(face)}"
            )
    return make_shape(
        S.HollowBox,
        6,
        size=validate.lengths(size, "hollow_box size"),
        wall=validate.length(wall, "hollow_box wall"),
        open=tuple(dict.fromkeys(faces)),
    )


@no_type_check
def lathe(
    profile: Sequence[Point2],
    thickness: float | None = None,
    sectors: int = 12,
    oval: float = 1.0,
) -> Shape:
    """Revolve a profile of (radius, z) points about the shape's z axis.

    With `thickness`, the profile is the outer face of a shell, such as a cup, a bowl or a plate,
    from the foot to the rim. The wall lies inside and above the profile. Without `thickness`, the
    profile bounds a solid. `oval` is a factor by which the shape is stretched along y.
    """
    outline = validate.points(profile, "lathe profile", 2, MAX_POINTS)
    count = validate.integer(sectors, "lathe sectors", MIN_SECTORS, MAX_SECTORS)
    wall = None if thickness is None else validate.length(thickness, "lathe thickness")
    bands = len(outline) - 1
    return make_shape(
        S.Lathe,
        bands if wall is None else bands * count,
        profile=outline,
        thickness=wall,
        sectors=count,
        oval=validate.number(oval, "lathe oval"),
    )


@no_type_check
def frustum(bottom_radius: float, top_radius: float, height: float) -> Shape:
    """Make a solid frustum along z, centered at the origin; a radius of 0 makes a cone."""
    radii = [
        0.0 if value == 0 else validate.length(value, f"frustum {name}")
        for value, name in ((bottom_radius, "bottom_radius"), (top_radius, "top_radius"))
    ]
    half = validate.length(height, "frustum height") / 2
    profile = ((radii[0], -half), (radii[1], half))
    return make_shape(S.Lathe, 1, profile=profile, sectors=32)


@no_type_check
def tube(radius: float, wall: float, height: float, sectors: int = 12) -> Shape:
    """Make an open pipe along z with outer radius `radius`, centered at the origin."""
    outer, half = validate.length(radius, "tube radius"), validate.length(height, "tube height") / 2
    thickness = validate.length(wall, "tube wall")
    if thickness >= outer:
        raise ValueError(f"tube wall {thickness} must be smaller than its radius {outer}")
    count = validate.integer(sectors, "tube sectors", MIN_SECTORS, MAX_SECTORS)
    profile = ((outer, -half), (outer, half))
    return make_shape(S.Lathe, count, profile=profile, thickness=thickness, sectors=count)


@no_type_check
def rounded_box(size: Vec3, radius: float) -> Shape:
    """Make a box with full edge lengths, centered at the origin, with edges rounded by `radius`."""
    edges = validate.lengths(size, "rounded_box size")
    return make_shape(S.RoundedBox, 1, size=edges, **_lengths("rounded_box", radius=radius))


@no_type_check
def sweep(
    path: Sequence[Vec3],
    radius: float | Sequence[float] | None = None,
    *,
    width: float | Sequence[float] | None = None,
    thickness: float | Sequence[float] | None = None,
    closed: bool = False,
    smooth: int = 1,
    sectors: int = 8,
) -> Shape:
    """Sweep a round or elliptic cross section along a path of points (x, y, z).

    Examples are a handle, a hook, a stem and a wire. For a round section, give `radius`. For an
    elliptic section, give the full diameters `width`, across the plane of the path, and
    `thickness`, in this plane. Each is one number, or one number for each point of a tapered shape.
    `smooth` is the number of segments between two points; they lie on a curve through all points.
    """
    track = tuple(
        validate.vector(point, f"sweep path[{i}]")
        for i, point in enumerate(validate.sequence(path, "sweep path", 2, MAX_POINTS))
    )
    if not isinstance(closed, bool):
        raise TypeError(f"sweep closed must be True or False, got {validate.formatted(closed)}")
    if (radius is None) == (width is None or thickness is None):
        raise ValueError("sweep needs radius=, or both width= and thickness=")
    if radius is not None:
        across = inward = tuple(2 * r for r in _each(radius, "sweep radius"))
    else:
        across, inward = _each(width, "sweep width"), _each(thickness, "sweep thickness")
    steps = validate.integer(smooth, "sweep smooth", 1, 8)
    track = _curved(track, steps, closed)
    return make_shape(
        S.Sweep,
        len(track),
        path=track,
        width=_interpolated(across, steps, closed),
        thickness=_interpolated(inward, steps, closed),
        closed=closed,
        sectors=validate.integer(sectors, "sweep sectors", 4, 32),
    )


@no_type_check
def torus(radius: float, tube: float, arc: float = 2 * math.pi, sectors: int = 8) -> Shape:
    """Make a ring around z, centered at the origin, or the part of it that spans `arc` [rad].

    The middle of the arc lies at +x. `radius` is the distance from the z axis to the center of the
    bar, and `tube` is the radius of the bar.
    """
    big, small = validate.length(radius, "torus radius"), validate.length(tube, "torus tube")
    span = validate.number(arc, "torus arc", 7.0)
    if not 0 < span <= 2 * math.pi + 1e-9:
        raise ValueError(f"torus arc must lie above 0 and up to 2 pi, got {span!r}")
    whole = span > 2 * math.pi - 1e-6
    steps = max(3, math.ceil(24 * span / (2 * math.pi)))
    angles = [span * (i / steps - 0.5) for i in range(steps if whole else steps + 1)]
    track = tuple((round(big * math.cos(a), 9), round(big * math.sin(a), 9), 0.0) for a in angles)
    return make_shape(
        S.Sweep,
        steps,
        path=track,
        width=(2 * small,),
        thickness=(2 * small,),
        closed=whole,
        sectors=validate.integer(sectors, "torus sectors", 4, 32),
    )


@no_type_check
def extrusion(
    outline: Sequence[Point2], height: float, holes: Sequence[Sequence[Point2]] = ()
) -> Shape:
    """Extrude an outline of (x, y) points with holes along z, from -height/2 to height/2."""
    border = validate.points(outline, "extrusion outline", 3, 2 * MAX_POINTS)
    loops = tuple(
        validate.points(hole, f"extrusion holes[{i}]", 3, MAX_POINTS)
        for i, hole in enumerate(validate.sequence(holes, "extrusion holes", 0, MAX_POINTS))
    )
    pieces = len(border) + sum(len(loop) + 2 for loop in loops)
    depth = validate.length(height, "extrusion height")
    return make_shape(S.Extrusion, pieces, outline=border, holes=loops, height=depth)


@no_type_check
def bail(width: float, height: float, radius: float) -> Shape:
    """Make a loop handle: a round bar that rises along z, bends over and returns to z = 0.

    The feet are at y = -width/2 and y = width/2, and the origin lies midway between them. `height`
    is the height of the bar's center line at the top. `radius` is the radius of the bar.
    """
    wide, high = validate.length(width, "bail width"), validate.length(height, "bail height")
    bar = validate.length(radius, "bail radius")
    bend = min(high, wide / 2)
    legs = [(0.0, -wide / 2, 0.0)] if high > bend * 1.02 else []
    turn = [math.pi * k / 12 for k in range(13)]
    arch = [
        (0.0, round(-wide / 2 * math.cos(a), 9), round(high - bend + bend * math.sin(a), 9))
        for a in turn
    ]
    track = (*legs, *arch, *((x, -y, z) for x, y, z in legs))
    return make_shape(
        S.Sweep, len(track), path=track, width=(2 * bar,), thickness=(2 * bar,), closed=False
    )


@no_type_check
def panel(
    size: Point2,
    thickness: float,
    holes: Sequence[Sequence[float]] = (),
    sectors: int = 16,
) -> Shape:
    """Make a flat board with through holes, centered at the origin.

    `size` is (x, y), and `thickness` is along z. A hole is (x, y, radius), or (x, y, width, depth)
    for a rectangle, where (x, y) is the hole's center.
    """
    x, y = (validate.length(v, "panel size") for v in validate.sequence(size, "panel size", 2, 2))
    facets = validate.integer(sectors, "panel sectors", MIN_SECTORS, MAX_SECTORS)
    loops = []
    for i, hole in enumerate(validate.sequence(holes, "panel holes", 0, MAX_POINTS)):
        argument = f"panel holes[{i}]"
        numbers = [
            validate.number(v, argument, validate.MAX_COORDINATE_M)
            for v in validate.sequence(hole, argument, 3, 4)
        ]
        if len(numbers) == 3:
            r = validate.length(numbers[2], f"{argument} radius")
            angles = [2 * math.pi * (k + 0.5) / facets for k in range(facets)]
            corners = [(r * math.cos(a), r * math.sin(a)) for a in angles]
        else:
            w, d = (validate.length(v, f"{argument} size") / 2 for v in numbers[2:])
            corners = [(-w, -d), (w, -d), (w, d), (-w, d)]
        loops.append([(round(numbers[0] + a, 9), round(numbers[1] + b, 9)) for a, b in corners])
    outline = [(-x / 2, -y / 2), (x / 2, -y / 2), (x / 2, y / 2), (-x / 2, y / 2)]
    return extrusion(outline, thickness, loops)


@no_type_check
def union(first: Shape, *others: Shape, sectors: int = 16) -> Shape:
    """Merge shapes, placed relative to each other by `Shape.moved`, into one solid."""
    return _combined("union", (first, *others), sectors)


@no_type_check
def difference(first: Shape, *others: Shape, sectors: int = 16) -> Shape:
    """Subtract the other shapes from the first shape, for example to make holes or pockets.

    Colliders have the same cavities as the visible shape. `sectors` is the number of facets of
    round operands.
    """
    return _combined("difference", (first, *others), sectors)


@no_type_check
def intersection(first: Shape, *others: Shape, sectors: int = 16) -> Shape:
    """Return the solid that all shapes have in common."""
    return _combined("intersection", (first, *others), sectors)


def _combined(operation: str, shapes: tuple[Any, ...], sectors: int) -> Shape:
    if not 2 <= len(shapes) <= MAX_POINTS:
        raise ValueError(f"{operation} takes 2 to {MAX_POINTS} shapes, got {len(shapes)}")
    for shape in shapes:
        if not isinstance(shape, Shape):
            raise TypeError(
                f"{operation} takes shapes such as box(...), got {validate.formatted(shape)}"
            )
    operands = tuple(
        S.Operand(
            shape=shape._spec,
            pos=tuple((np.round(shape._pose.pos, 9) + 0.0).tolist()),
            quat=tuple((np.round(shape._pose.quat, 12) + 0.0).tolist()),
        )
        for shape in shapes
    )
    count = validate.integer(sectors, f"{operation} sectors", MIN_SECTORS, MAX_SECTORS)
    solid = validate.build_spec(
        S.CSG, operation, operation=operation, operands=operands, sectors=count
    )
    current().use("pieces built", len(solid.pieces()), 4 * current().max_pieces)
    return Shape(solid)


def _curved(track: tuple[Point3, ...], steps: int, closed: bool) -> tuple[Point3, ...]:
    """Divide every segment of a path along a Catmull-Rom curve through the path's points."""
    if steps == 1:
        return track
    count = len(track)
    if (count if closed else count - 1) * steps + 1 > MAX_POINTS:
        raise ValueError(f"sweep would have over {MAX_POINTS} points: lower smooth")
    if closed:
        points = np.array([track[-1], *track, *track[:2]])
    else:  # Extrapolate one point at either end.
        inner = np.array(track)
        points = np.array([2 * inner[0] - inner[1], *inner, 2 * inner[-1] - inner[-2]])
    divided: list[Point3] = []
    for i in range(count if closed else count - 1):
        for fraction in np.arange(steps) / steps:
            weights = fraction ** np.arange(4) @ _CATMULL_ROM
            x, y, z = np.round(weights @ points[i : i + 4], 9).tolist()
            divided.append((x, y, z))
    return tuple(divided) if closed else (*divided, track[-1])


def _interpolated(values: tuple[float, ...], steps: int, closed: bool) -> tuple[float, ...]:
    """Interpolate values at the points of a path linearly to the points of the divided path."""
    if len(values) == 1 or steps == 1:
        return values
    pairs = list(zip(values, (*values[1:], values[0]), strict=True))
    divided = [
        a + (b - a) * step / steps
        for a, b in (pairs if closed else pairs[:-1])
        for step in range(steps)
    ]
    return tuple(divided) if closed else (*divided, values[-1])


def _each(value: Any, argument: str) -> tuple[float, ...]:
    """Validate one length [m], or one length for each point of a path."""
    if isinstance(value, list | tuple):
        return tuple(
            validate.length(v, argument) for v in validate.sequence(value, argument, 1, MAX_POINTS)
        )
    return (validate.length(value, argument),)


def _lengths(shape: str, **values: Any) -> dict[str, float]:
    """Validate lengths [m], and return them by argument name."""
    return {key: validate.length(value, f"{shape} {key}") for key, value in values.items()}


def make_shape(model: Any, pieces: int, **fields: Any) -> Shape:
    """Build a shape from validated fields; count the given number of convex pieces."""
    name = model.model_fields["type"].default
    if pieces > MAX_SHAPE_PIECES:
        raise ValueError(
            f"{name} would need {pieces} convex pieces, at most {MAX_SHAPE_PIECES} are allowed: "
            f"give it fewer points or sectors"
        )
    current().use("pieces built", pieces, 4 * current().max_pieces)
    return Shape(validate.build_spec(model, name, **fields))


PatternPoint = tuple[float, float, float]
MAX_COUNT = 1000


@no_type_check
def grid(
    counts: tuple[int, int], steps: Point2, centre: Vec3 = (0.0, 0.0, 0.0)
) -> list[tuple[float, float, float]]:
    """Return the points of a grid in x and y around a center; x varies fastest."""
    columns, rows = (
        validate.integer(v, "grid counts", 1, MAX_COUNT)
        for v in validate.sequence(counts, "grid counts", 2, 2)
    )
    if columns * rows > MAX_COUNT:
        raise ValueError(f"grid makes at most {MAX_COUNT} points, got {columns} x {rows}")
    dx, dy = validate.pair(steps, "grid steps")
    x, y, z = validate.vector(centre, "grid centre")
    return [
        (x + dx * (i - (columns - 1) / 2), y + dy * (j - (rows - 1) / 2), z)
        for j in range(rows)
        for i in range(columns)
    ]


@no_type_check
def ring(
    count: int, radius: float, centre: Vec3 = (0.0, 0.0, 0.0), start: float = 0.0
) -> list[tuple[float, float, float]]:
    """Return points on a horizontal circle; point k lies at the angle start + 2 pi k / count."""
    total = validate.integer(count, "ring count", 1, MAX_COUNT)
    r = validate.length(radius, "ring radius")
    x, y, z = validate.vector(centre, "ring centre")
    first = validate.number(start, "ring start", 200.0)
    angles = [first + 2 * math.pi * k / total for k in range(total)]
    return [(x + r * math.cos(a), y + r * math.sin(a), z) for a in angles]


@no_type_check
def mirror(
    points: Vec3 | Sequence[Vec3], across: Literal["x", "y", "z"] = "y", at: float = 0.0
) -> list[tuple[float, float, float]]:
    """Return each point, followed by its mirror image across a plane.

    A point on the plane has no image.

    Args:
        points: one point (x, y, z) or a list of points.
        across: normal of the plane: "x" (exchanges front and back), "y" (exchanges left and right)
            or "z" (exchanges top and bottom).
        at: position of the plane along the normal [m].
    """
    if across not in ("x", "y", "z"):
        raise ValueError(f"mirror across is 'x', 'y' or 'z', got {validate.formatted(across)}")
    k, plane = "xyz".index(across), validate.number(at, "mirror at", validate.MAX_COORDINATE_M)
    originals = validate.sequence(points, "mirror points", 1, MAX_COUNT)
    if not isinstance(originals[0], list | tuple):
        originals = [originals]
    mirrored: list[PatternPoint] = []
    for i, original in enumerate(originals):
        point = validate.vector(original, f"mirror points[{i}]")
        image = list(point)
        image[k] = 2 * plane - image[k]
        mirrored.append(point)
        if image[k] != point[k]:
            x, y, z = image
            mirrored.append((x, y, z))
    return mirrored

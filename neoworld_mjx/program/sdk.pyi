from collections.abc import Sequence
from typing import Literal

Vec3 = tuple[float, float, float] | list[float]
Point2 = tuple[float, float] | list[float]
Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]

class Shape:
    @property
    def size(self) -> tuple[float, float, float]: ...
    @property
    def volume(self) -> float: ...
    def distance(self, point: Vec3) -> float: ...
    def moved(
        self, at: Vec3 = (0.0, 0.0, 0.0), rpy: Vec3 = (0.0, 0.0, 0.0), *, by: str = ""
    ) -> Shape: ...

class Geom:
    name: str
    def anchor(self, where: str) -> tuple[float, float, float]: ...

class Part:
    name: str
    def add(
        self,
        shape: Shape,
        at: Vec3 = (0.0, 0.0, 0.0),
        rpy: Vec3 = (0.0, 0.0, 0.0),
        *,
        by: str = "",
        material: str | None = None,
        rgb: Vec3 | None = None,
        role: Literal["both", "visual", "collision"] = "both",
        name: str | None = None,
    ) -> Geom: ...
    def anchor(self, where: str) -> tuple[float, float, float]: ...
    def set_mass(self, mass: float) -> None: ...

class Joint:
    name: str
    def set_dynamics(
        self,
        *,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float | None = None,
        effort: float | None = None,
        velocity: float | None = None,
    ) -> None: ...

After = Part | Joint | Sequence[Part | Joint] | None

class Object:
    name: str
    label: str
    def __init__(self, name: str, label: str = "") -> None: ...
    def material(
        self,
        name: str,
        like: str | None = None,
        *,
        density: float | None = None,
        friction: float | None = None,
        rgb: Vec3 | None = None,
        alpha: float | None = None,
        pattern: str | None = None,
        rgb2: Vec3 | None = None,
        step: float | None = None,
        along: Literal["x", "y"] = "x",
        metallic: float | None = None,
        roughness: float | None = None,
    ) -> str: ...
    def part(self, name: str, material: str | None = None, mass: float | None = None) -> Part: ...
    def site(self, name: str, part: Part, at: Vec3) -> None: ...
    def allow_overlap(self, first: Part, second: Part, depth: float, reason: str) -> None: ...
    def door(
        self,
        name: str,
        parent: Part,
        *,
        x: float,
        y: Point2,
        z: Point2,
        hinge: Literal["left", "right", "top", "bottom"],
        thickness: float = 0.018,
        gap: float = 0.001,
        opens: float | None = None,
        after: After = None,
        material: str | None = None,
    ) -> Part: ...
    def drawer(
        self,
        name: str,
        parent: Part,
        *,
        x: float,
        y: Point2,
        z: Point2,
        depth: float,
        wall: float = 0.01,
        front: float = 0.018,
        overlay: float = 0.0,
        gap: float = 0.002,
        travel: float | None = None,
        after: After = None,
        material: str | None = None,
    ) -> Part: ...
    def shelf(
        self,
        parent: Part,
        *,
        x: Point2,
        y: Point2,
        z: float,
        thickness: float = 0.018,
        material: str | None = None,
        name: str | None = None,
    ) -> Geom: ...
    def fixed(self, name: str, parent: Part, child: Part) -> Joint: ...
    def revolute(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Vec3 | str,
        axis: Vec3 | str | None = None,
        range: Point2,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
        after: After = None,
        opens: Vec3 | str | None = None,
    ) -> Joint: ...
    def continuous(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Vec3 | str,
        axis: Vec3 | str,
        damping: float | None = None,
        friction: float | None = None,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
        after: After = None,
    ) -> Joint: ...
    def ball(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        at: Vec3 | str,
        swing: float | None = None,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        after: After = None,
    ) -> Joint: ...
    def prismatic(
        self,
        name: str,
        parent: Part,
        child: Part,
        *,
        axis: Vec3 | str,
        range: Point2,
        at: Vec3 | str | None = None,
        damping: float | None = None,
        friction: float | None = None,
        stiffness: float = 0.0,
        effort: float | None = None,
        velocity: float | None = None,
        mimic: Joint | None = None,
        multiplier: float = 1.0,
        offset: float = 0.0,
        after: After = None,
        opens: Vec3 | str | None = None,
    ) -> Joint: ...

def box(size: Vec3) -> Shape: ...
def sphere(radius: float) -> Shape: ...
def capsule(radius: float, length: float) -> Shape: ...
def cylinder(radius: float, height: float) -> Shape: ...
def ellipsoid(radii: Vec3) -> Shape: ...
def prism(outline: Sequence[Point2], height: float) -> Shape: ...
def hollow_box(size: Vec3, wall: float, open: Face | Sequence[Face] = "+z") -> Shape: ...
def lathe(
    profile: Sequence[Point2], thickness: float | None = None, sectors: int = 12, oval: float = 1.0
) -> Shape: ...
def frustum(bottom_radius: float, top_radius: float, height: float) -> Shape: ...
def tube(radius: float, wall: float, height: float, sectors: int = 12) -> Shape: ...
def rounded_box(size: Vec3, radius: float) -> Shape: ...
def sweep(
    path: Sequence[Vec3],
    radius: float | Sequence[float] | None = None,
    *,
    width: float | Sequence[float] | None = None,
    thickness: float | Sequence[float] | None = None,
    closed: bool = False,
    smooth: int = 1,
    sectors: int = 8,
) -> Shape: ...
def torus(radius: float, tube: float, arc: float = ..., sectors: int = 8) -> Shape: ...
def loft(sections: Sequence[Vec3], square: float = 2.0, sectors: int = 16) -> Shape: ...
def extrusion(
    outline: Sequence[Point2], height: float, holes: Sequence[Sequence[Point2]] = ()
) -> Shape: ...
def bail(width: float, height: float, radius: float) -> Shape: ...
def panel(
    size: Point2, thickness: float, holes: Sequence[Sequence[float]] = (), sectors: int = 16
) -> Shape: ...
def union(first: Shape, *others: Shape, sectors: int = 16) -> Shape: ...
def difference(first: Shape, *others: Shape, sectors: int = 16) -> Shape: ...
def intersection(first: Shape, *others: Shape, sectors: int = 16) -> Shape: ...
def grid(
    counts: tuple[int, int], steps: Point2, centre: Vec3 = (0.0, 0.0, 0.0)
) -> list[tuple[float, float, float]]: ...
def ring(
    count: int, radius: float, centre: Vec3 = (0.0, 0.0, 0.0), start: float = 0.0
) -> list[tuple[float, float, float]]: ...
def mirror(
    points: Vec3 | Sequence[Vec3], across: Literal["x", "y", "z"] = "y", at: float = 0.0
) -> list[tuple[float, float, float]]: ...

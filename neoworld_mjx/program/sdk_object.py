"""The object that a program creates, with materials, parts, sites and allowed overlaps."""

from collections.abc import Sequence
from typing import Any, Literal, no_type_check

from .. import spec as S
from ..checks.allowance import Allowance
from ..errors import choices
from . import validate
from .furniture import Furniture
from .materials import MATERIALS, inherited_finish, stated_finish
from .part import Joint, Part
from .sdk_types import Vec3
from .session import current

MAX_ALLOWED_M, MIN_REASON = 0.005, 10


@no_type_check
class Object(Furniture):
    """The object of a program, which must create exactly one.

    Args:
        name: an identifier, such as "cup".
        label: the kind of object, in words.
    """

    name: str
    label: str

    def __init__(self, name: str, label: str = "") -> None:
        self.name = validate.name(name, "Object name")
        self.label = validate.text(label, "Object label")
        self._parts: list[Part] = []
        self._joints: list[Joint] = []
        self._sites: list[S.Site] = []
        self._allowances: list[Allowance] = []
        self._materials: dict[str, S.Material] = {}
        self._geom_names: set[str] = set()
        current().objects.append(self)

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
    ) -> str:
        """Define a material, and return its name.

        Omitted properties are copied from the material `like`. If `like` is None, they are copied
        from the named material `name`, if it exists.

        Args:
            name: name of the material.
            like: name of a named material or of a material that the program defined before.
            density: density [kg/m^3].
            friction: coefficient of sliding friction.
            rgb: red, green and blue, each from 0 to 1.
            alpha: opacity from 0 to 1.
            pattern: "plain", "grain", "boards", "tiles", "bricks", "veins", "speckles", "weave" or
                "brushed".
            rgb2: color of the pattern's joints, veins, speckles or gaps.
            step: scale of the pattern [m]: the width of a board, the edge of a tile, the height of
                a brick, the spacing of veins, and so on.
            along: axis of a face along which boards run: the first ("x") or the second ("y").
            metallic: from 0 to 1; by default the value of the substance in the name, such as
                "steel".
            roughness: from 0 (a mirror) to 1; by default the value of the substance in the name.
        """
        context = f"material {validate.name(name, 'material name')!r}"
        if name in self._materials:
            raise ValueError(f"{context} is defined twice")
        base = MATERIALS.get(name) if like is None else self._known_material(like, context)
        if base is None and density is None:
            raise ValueError(f"{context} needs density= or like= (a named material)")
        fields: dict[str, Any] = {"density": 1000.0, "friction": 0.45}
        fields |= {} if base is None else base.model_dump()
        fields |= {} if base is None else inherited_finish(base, name)
        fields["name"] = name
        if density is not None:
            fields["density"] = validate.number(density, f"{context}: density")
        if friction is not None:
            fields["friction"] = validate.number(friction, f"{context}: friction")
        r, g, b, a = fields.get("rgba", (0.7, 0.7, 0.7, 1.0))
        if rgb is not None:
            r, g, b = validate.colour(rgb, f"{context}: rgb")
            a = 1.0 if base is None or base == MATERIALS.get(base.name) else a
        a = a if alpha is None else validate.number(alpha, f"{context}: alpha")
        fields["rgba"] = (r, g, b, a)
        fields |= stated_finish(pattern, rgb2, step, along, metallic, roughness, context)
        self._materials[name] = validate.build_spec(S.Material, context, **fields)
        return name

    def part(self, name: str, material: str | None = None, mass: float | None = None) -> Part:
        """Add a rigid part, and return it.

        Args:
            name: name that is unique among the object's parts.
            material: default material of the part's shapes.
            mass: mass [kg]; by default the mass follows from volume and density.
        """
        label = validate.name(name, "part name")
        validate.unused(label, "part", [part.name for part in self._parts])
        if material is not None:
            self._known_material(material, f"part {label!r}")
        if mass is not None and validate.number(mass, f"part {label!r}: mass") <= 0:
            raise ValueError(f"part {label!r}: mass must be positive, got {mass!r}")
        session = current()
        session.use("parts", 1, session.max_parts)
        part = Part(self, label, material, None if mass is None else float(mass))
        self._parts.append(part)
        return part

    def site(self, name: str, part: Part, at: Vec3) -> None:
        """Mark a point on a part, such as a grasp point or a spout."""
        label = validate.name(name, "site name")
        validate.unused(label, "site", [site.name for site in self._sites])
        self._check_part(part, f"site {label!r}: part")
        session = current()
        session.use("sites", 1, session.max_geoms)
        position = validate.vector(at, f"site {label!r}: at")
        self._sites.append(S.Site(name=label, part=part.name, pos=position))

    def allow_overlap(self, first: Part, second: Part, depth: float, reason: str) -> None:
        """Allow two parts to overlap by up to `depth` [m], for a stated reason.

        `depth` may be at most 0.005 m.
        """
        self._check_part(first, "allow_overlap: first")
        self._check_part(second, "allow_overlap: second")
        depth = validate.length(depth, "allow_overlap: depth")
        reason = validate.text(reason, "allow_overlap: reason")
        if depth > MAX_ALLOWED_M or len(reason) < MIN_REASON:
            raise ValueError(
                f"allow_overlap takes a depth up to {MAX_ALLOWED_M} m and a reason of "
                f"{MIN_REASON} letters and more"
            )
        session = current()
        session.use("allowances", 1, session.max_parts)
        self._allowances.append(Allowance(first.name, second.name, depth, reason))

    def _known_material(self, name: Any, context: str) -> S.Material:
        label = validate.name(name, f"{context}: material")
        material = self._materials.get(label) or MATERIALS.get(label)
        if material is None:
            known = sorted({*self._materials, *MATERIALS})
            raise ValueError(f"{context}: material: {choices(label, known)}")
        return material

    def _shade(self, name: str | None, rgb: Sequence[float] | None, context: str) -> str:
        """Define a material on first use, recolored if `rgb` is not None, and return its name."""
        if name is None:
            raise ValueError(f"{context}: needs material=, as the part has none of its own")
        base = self._known_material(name, context)
        if rgb is not None:
            r, g, b = validate.colour(rgb, f"{context}: rgb")
            tint = "".join(f"{round(255 * v):02x}" for v in (r, g, b))
            shaded = f"{base.name[:40]}_{tint}"
            base = base.model_copy(update={"name": shaded, "rgba": (r, g, b, 1.0)})
        self._materials.setdefault(base.name, base)
        return base.name

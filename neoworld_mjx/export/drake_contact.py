"""Drake's extensions of URDF and SDF: hydroelastic contact and collision filters.

By default, Drake uses point contact with a stiffness of 1e6 N/m and one point for each pair of
colliders. With point contact, a cup rotates by degrees within seconds, and a cupboard sinks by
centimeters. Compliant hydroelastic colliders instead exert a pressure over the area of overlap. If
the other collider is neither compliant nor rigid, Drake falls back to point contact, so users must
declare their floor to be compliant or rigid.
"""

import math
import xml.etree.ElementTree as ET
from typing import Literal

from ..spec import ObjectSpec
from ..spec.convex import Piece
from .link_frames import unjoined_pairs
from .meshes import number

DRAKE = "http://drake.mit.edu"
"""XML namespace of Drake's elements."""
MODULUS_PA = 1e8
"""Hydroelastic modulus: the pressure at the innermost points of a collider [Pa].

With this value, settled objects overlap by micrometers.
"""
SIDES = 32
"""Number of sides of the polygon that approximates a circle in a contact surface."""
Format = Literal["urdf", "sdf"]
"""File format: URDF stores a value in an attribute, SDF in the text of an element."""


def add_contact(collision: ET.Element, form: Format, piece: Piece, friction: float) -> None:
    """Add the compliance and the friction of a collider to its <collision> element."""
    properties = ET.SubElement(collision, "drake:proximity_properties")
    ET.SubElement(properties, "drake:compliant_hydroelastic")
    values = {"hydroelastic_modulus": MODULUS_PA, "mu_static": friction, "mu_dynamic": friction}
    if piece.kind not in ("box", "mesh"):
        radius = max(piece.size) if piece.kind == "ellipsoid" else piece.size[0]
        values["mesh_resolution_hint"] = round(2 * math.pi * radius / SIDES, 6)
    for name, value in values.items():
        _put(properties, form, name, "value", number(value))


def declare_convex(mesh: ET.Element) -> None:
    """Declare that the mesh of a collider is convex."""
    ET.SubElement(mesh, "drake:declare_convex")


def add_filters(model: ET.Element, form: Format, spec: ObjectSpec, links: dict[str, str]) -> None:
    """Add collision filters for pairs of links that never collide and that no joint connects.

    Drake itself filters pairs that a joint connects.

    Args:
        model: the <robot> or <model> element.
        form: format of the file.
        spec: the object.
        links: link name of each part, by part name.
    """
    ignored: dict[str, list[str]] = {}
    for first, second in unjoined_pairs(spec):
        ignored.setdefault(links[first], []).append(links[second])
        ignored.setdefault(links[second], [])
    for link, others in ignored.items():
        group = ET.SubElement(model, "drake:collision_filter_group", name=f"only_{link}")
        _put(group, form, "member", "link", link)
        for second in others:
            _put(group, form, "ignored_collision_filter_group", "name", f"only_{second}")


def _put(parent: ET.Element, form: Format, tag: str, attribute: str, value: str) -> None:
    element = ET.SubElement(parent, f"drake:{tag}")
    if form == "urdf":
        element.set(attribute, value)
    else:
        element.text = value

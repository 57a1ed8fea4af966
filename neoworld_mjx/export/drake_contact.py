"""What URDF and SDF say to Drake alone: how colliders touch, and which never do.

By default Drake takes one point of contact for each pair of colliders, with 1e6 N/m: a cup turns by
degrees within seconds, and a cupboard sinks by centimetres. So colliders are compliant, with a
pressure over the area in which they overlap (hydroelastic contact). Against a collider that states
neither compliance nor rigidity Drake falls back to the point; a user's floor has to state one.
"""

import math
import xml.etree.ElementTree as ET
from typing import Literal

from ..physics.mjcf import excluded_pairs
from ..spec import ObjectSpec
from ..spec.convex import Piece
from .meshes import number

DRAKE = "http://drake.mit.edu"
"""XML namespace of Drake's elements."""
MODULUS_PA = 1e8
"""Pressure at the innermost points of a collider [Pa]; things rest with micrometres of overlap."""
SIDES = 32
"""Of the polygon that stands for a circle in areas of contact."""
Format = Literal["urdf", "sdf"]
"""URDF has values in attributes, SDF in texts."""


def add_contact(collision: ET.Element, form: Format, piece: Piece, friction: float) -> None:
    """Add to a collider's element its compliance and friction."""
    properties = ET.SubElement(collision, "drake:proximity_properties")
    ET.SubElement(properties, "drake:compliant_hydroelastic")
    values = {"hydroelastic_modulus": MODULUS_PA, "mu_static": friction, "mu_dynamic": friction}
    if piece.kind not in ("box", "mesh"):
        radius = max(piece.size) if piece.kind == "ellipsoid" else piece.size[0]
        values["mesh_resolution_hint"] = round(2 * math.pi * radius / SIDES, 6)
    for name, value in values.items():
        _put(properties, form, name, "value", number(value))


def declare_convex(mesh: ET.Element) -> None:
    """Say of a collider's mesh that it is convex."""
    ET.SubElement(mesh, "drake:declare_convex")


def add_filters(model: ET.Element, form: Format, spec: ObjectSpec, links: dict[str, str]) -> None:
    """Add the pairs of links that never collide, but for those that share a joint: Drake knows.

    Args:
        model: element of the robot or model.
        form: of the file.
        spec: the object.
        links: the links' names by part.
    """
    joined = {(joint.parent, joint.child) for joint in spec.joints}
    ignored: dict[str, list[str]] = {}
    for one, other in excluded_pairs(spec):
        if (one, other) not in joined:
            ignored.setdefault(links[one], []).append(links[other])
            ignored.setdefault(links[other], [])
    for link, others in ignored.items():
        group = ET.SubElement(model, "drake:collision_filter_group", name=f"only_{link}")
        _put(group, form, "member", "link", link)
        for other in others:
            _put(group, form, "ignored_collision_filter_group", "name", f"only_{other}")


def _put(parent: ET.Element, form: Format, tag: str, attribute: str, value: str) -> None:
    element = ET.SubElement(parent, f"drake:{tag}")
    if form == "urdf":
        element.set(attribute, value)
    else:
        element.text = value

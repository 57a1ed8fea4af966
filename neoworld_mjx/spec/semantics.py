"""Semantics of objects: the category of an object, and the purposes of its joints."""

import re
from typing import Any

from .joint import JointSpec
from .object import ObjectSpec

_PURPOSES = (
    "drawer", "door", "lid", "flap", "hatch", "tray", "rack", "shelf", "cover", "button", "switch",
    "knob", "dial", "lever", "pedal", "key", "tap", "faucet", "spout", "wheel", "caster", "fan",
    "blade", "seat", "backrest", "arm", "leg", "handle", "shade", "screen", "slider", "turntable",
)  # fmt: skip
_BY_MOTION = {"prismatic": "slide", "revolute": "hinge", "continuous": "turn", "ball": "swivel"}
_AFTER_HEAD = re.compile(r"\b(with|of|on|in|for|from|that|to|and|by|without)\b|[,;(]")


def category(spec: ObjectSpec) -> str:
    """Return the head noun of an object's label or, if the label has none, of its name.

    For example, "chest" for "oak chest with a drawer".
    """
    words = re.findall(r"[a-z]+", _AFTER_HEAD.split(spec.label.lower())[0])
    if not words:
        words = re.findall(r"[a-z]+", spec.name.lower())
    return words[-1] if words else spec.name


def purpose(spec: ObjectSpec, joint: JointSpec) -> str:
    """Return the purpose of a joint, such as "drawer" or "knob".

    The purpose follows from the names of the joint's child, the joint, or the child's geoms. If no
    name contains a known purpose, it follows from the type of the joint.
    """
    if joint.type == "fixed":
        return "fixed"
    geoms = (geom.name for geom in spec.part(joint.child).geoms)
    for name in (joint.child, joint.name, *geoms):
        words = re.findall(r"[a-z]+", name.lower())
        for word in reversed(words):
            if word in _PURPOSES:
                return word
            if word.endswith("s") and word[:-1] in _PURPOSES:
                return word[:-1]
    return _BY_MOTION[joint.type]


def semantics_of(spec: ObjectSpec) -> dict[str, Any]:
    """Return an object's label, category, part names and joint purposes as a dict for JSON."""
    return {
        "label": spec.label,
        "category": category(spec),
        "parts": [part.name for part in spec.parts],
        "joints": {joint.name: purpose(spec, joint) for joint in spec.joints},
    }

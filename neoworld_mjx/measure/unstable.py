"""Objects of a scene that leave their composed poses, and the reasons why."""

from collections.abc import Sequence
from typing import Literal

from ..spec import SceneObject, SceneSpec, Spec
from .stability import SceneMeasure

FALLS_M = 0.03
"""Descent above which an object falls, as opposed to an object that settles or topples."""


class UnstableObject(Spec):
    """An object that leaves its composed pose under gravity."""

    name: str
    kind: Literal["falls", "topples", "slides", "diverges"]
    drop_m: float
    """Largest descent [m]."""
    drift_m: float
    tilt_deg: float
    held: bool
    """False if the object is attached but not fastened, in which case no layout makes it stable."""
    why: str

    def phrase(self) -> str:
        """Return one line, such as "frame falls 1.64 m: it is attached to wall, but ..."."""
        motion = {
            "falls": f"falls {self.drop_m:.2g} m",
            "topples": f"topples by {self.tilt_deg:.0f} deg",
            "slides": f"moves {1e3 * self.drift_m:.0f} mm",
            "diverges": "makes the simulation diverge",
        }[self.kind]
        return f"{self.name} {motion}: {self.why}"


def unstable_objects(
    scene: SceneSpec, measure: SceneMeasure, *, max_drift: float = 0.01, max_tilt: float = 5.0
) -> tuple[UnstableObject, ...]:
    """Return the objects that exceed a bound of motion, and the reasons, the worst kinds first.

    Objects that make the simulation diverge come first, followed by objects that fall, topple and
    slide.

    Args:
        scene: the measured scene.
        measure: measures of the scene.
        max_drift: translation bound [m].
        max_tilt: rotation bound [deg].
    """
    moving = [
        obj
        for obj in scene.objects
        if not obj.static
        and not (measure.drift_m[obj.name] < max_drift and measure.tilt_deg[obj.name] < max_tilt)
    ]
    names = {obj.name for obj in moving}
    entries = [_entry(scene, obj, measure, names, max_tilt) for obj in moving]
    order = ("diverges", "falls", "topples", "slides")
    return tuple(sorted(entries, key=lambda entry: (order.index(entry.kind), -entry.drop_m)))


def phrases(entries: Sequence[UnstableObject]) -> str:
    """Return one line that names all entries."""
    return "; ".join(entry.phrase() for entry in entries)


def _entry(
    scene: SceneSpec, obj: SceneObject, measure: SceneMeasure, moving: set[str], max_tilt: float
) -> UnstableObject:
    name = obj.name
    drop, tilt = measure.drop_m.get(name, 0.0), measure.tilt_deg[name]
    held = obj.relation != "attached"
    kind: Literal["falls", "topples", "slides", "diverges"] = "slides"
    if not (drop < float("inf") and tilt < float("inf")):
        kind = "diverges"
    elif drop > FALLS_M:
        kind = "falls"
    elif tilt >= max_tilt:
        kind = "topples"
    return UnstableObject(
        name=name,
        kind=kind,
        drop_m=drop,
        drift_m=measure.drift_m[name],
        tilt_deg=tilt,
        held=held,
        why=_why(scene, obj, measure, moving, kind),
    )


def _why(
    scene: SceneSpec, obj: SceneObject, measure: SceneMeasure, moving: set[str], kind: str
) -> str:
    if obj.relation == "attached":
        host = None if obj.parent is None else scene.object(obj.parent)
        free = "" if host is None or host.static else ", which is free to move"
        return f"it is attached to {obj.parent or 'the world'}{free}, but not fastened there"
    parent = obj.parent
    if parent in moving:
        return f"{parent}, which supports it, moves"
    deep = {pair: depth for pair, depth in measure.depths_m.items() if obj.name in pair.split("|")}
    if deep:
        pair = max(deep, key=deep.__getitem__)
        other = next(part for part in pair.split("|") if part != obj.name)
        if deep[pair] > 1e-3:
            return f"it initially penetrates {other} by {1e3 * deep[pair]:.1f} mm"
    if obj.relation == "leaning":
        return f"it stands on {parent}, and nothing that it leans against holds it"
    if kind == "falls":
        return f"{parent} is not below it, or does not hold it"
    return f"it does not rest on {parent}"

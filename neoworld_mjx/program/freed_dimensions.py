"""Corrections of dimensions in programs where the contour of an object contradicts its shape.

The dimensions are named constants, and one constant of an object is changed at a time. The
alignment estimates three stretch factors of every object and discards them. If they show that a
shape is wrong, `dimension_candidates` selects the constant of the object's program whose change
explains the pixels best. The scene is then composed and aligned again with the changed object. The
pixels in which the outlines before and after differ decide whether the change is kept.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np
from jaxtyping import Bool, UInt8

from ..align.acceptance import gain
from ..align.alignment import Alignment, DimensionEdit, FreedObject
from ..align.colors import LabImage
from ..align.outline_error import outline_errors
from ..align.rasterize import draw_scene, height_of
from ..spec import ObjectSpec, SceneSpec
from .dimension_candidates import (
    Candidate,
    Contours,
    best_candidate,
    sensitivities,
    significant,
)
from .named_constants import named_constants, with_value

WIDTH_PX = 640
"""Width of the image in which outlines are compared [px]."""
LEAST_GAIN = 20.0
"""Smallest log likelihood ratio of the outline after a change to the outline before it [nats].

The first change of a constant is dropped if the ratio is smaller; a further change of the same
constant only needs a positive ratio. The ratio treats pixels as independent, but neighboring pixels
are not, so the limit is far above 0.
"""
STEPS = 3
"""Largest number of rounds; in each round, changes are proposed and the scene is aligned again."""
UNCHANGED = "its outline agrees with its proportions"
UNFAVORED = "the pixels favor no change of a dimension"
NO_CONSTANT = "no named constant of its program changes its proportions alone"


@dataclass(frozen=True)
class EditablePrograms:
    """Programs of a scene's objects, and functions that build, check and compose edited ones."""

    texts: Mapping[str, str]
    """Program of each object that may be edited, by object name."""
    build: Callable[[str, str], ObjectSpec | str]
    """Builds an object from its name and a program; if it cannot be built, returns the reason."""
    check: Callable[[str, str], str]
    """Returns why the object with a name and a program is invalid; empty if it is valid."""
    compose: Callable[[Mapping[str, ObjectSpec]], SceneSpec]
    """Composes the scene with some objects replaced, by name.

    The geometric mean of the edges of each replaced object is preserved.
    """
    unchangeable: Mapping[str, str] = field(default_factory=dict)
    """Why an object is not in `texts`, by object name."""


@dataclass(frozen=True)
class FreedScene:
    """Result of `free_dimensions`."""

    composed: SceneSpec
    """The composed scene with the changed objects."""
    alignment: Alignment
    """Alignment of `composed`, with `Alignment.dimensions`."""
    texts: Mapping[str, str] = field(default_factory=dict)
    """New program of each changed object, by name."""
    specs: Mapping[str, ObjectSpec] = field(default_factory=dict)
    """Objects that the new programs build, by name."""


@dataclass(frozen=True)
class _Proposal:
    candidate: Candidate
    text: str
    spec: ObjectSpec
    further: bool
    """True if the constant was changed before."""

    @property
    def name(self) -> str:
        return self.candidate.constant.name

    def refused(self, why: str) -> str:
        before = self.candidate.constant.value
        return f"{self.name} {before:.4g} -> {self.candidate.value:.4g}: {why}"


@dataclass(frozen=True)
class _Object:
    """State of one object: its program, its outline, and the changes that were tried."""

    text: str
    original: dict[str, float]
    """Values of the program's constants before the first change."""
    shown: Bool[np.ndarray, "row column"]
    outline_px: float | None
    first_px: float | None
    """Error of the outline before the first change [px]."""
    spec: ObjectSpec | None = None
    """Object that the changed program builds; None if the program is unchanged."""
    changed: str = ""
    """Name of the constant that was just changed and may be changed further; empty if none."""
    edited: tuple[str, ...] = ()
    """Names of the changed constants."""
    refused: Mapping[str, str] = field(default_factory=dict)
    """Reason why a change was refused, by name of the constant."""
    reason: str = UNCHANGED
    current: bool = True
    """False if the last alignment was made with a shape that was refused."""

    def without(self, name: str, why: str) -> "_Object":
        return replace(self, refused={**self.refused, name: why}, changed="", reason=why)


def free_dimensions(
    composed: SceneSpec,
    alignment: Alignment,
    photo: UInt8[np.ndarray, "row column 3"],
    programs: EditablePrograms,
    align: Callable[[SceneSpec], Alignment],
) -> FreedScene:
    """Change dimensions of programs where the photograph contradicts them.

    Args:
        composed: the composed scene.
        alignment: the alignment of `composed`.
        photo: the photograph (sRGB).
        programs: the programs of the scene's objects.
        align: aligns a composed scene.

    Returns:
        The scene with the changed objects, composed and aligned again. If no change is kept, the
        given scene and alignment.
    """
    if alignment.fitted is None:
        return FreedScene(composed, alignment)
    programs = replace(programs, build=cache(programs.build))
    best = FreedScene(composed, alignment)
    contours = _contours(alignment, photo)
    objects, others = _states(contours, alignment, programs)
    for _ in range(STEPS):
        proposals: dict[str, _Proposal] = {}
        for name, own in objects.items():
            objects[name], proposal = _proposed(name, own, contours, programs)
            if proposal is not None:
                proposals[name] = proposal
        if not proposals:
            break
        specs = _specs(objects)
        scene = programs.compose(specs | {name: p.spec for name, p in proposals.items()})
        trial = align(scene)
        if trial.fitted is None:
            break
        contours = _contours(trial, photo)
        objects = _judged(objects, proposals, contours, programs)
        if all(objects[name].text == p.text for name, p in proposals.items()):
            best = FreedScene(scene, trial, {}, _specs(objects))
    if best.specs != _specs(objects):
        # The last alignment was made with changes that were refused.
        scene = programs.compose(_specs(objects))
        best = FreedScene(scene, align(scene), {}, _specs(objects))
    return _result(best, objects, others, photo)


def _states(
    contours: Contours, alignment: Alignment, programs: EditablePrograms
) -> tuple[dict[str, _Object], dict[str, str]]:
    """Return the objects whose programs may be changed, and for each other object the reason."""
    objects, others, texts = {}, {}, programs.texts
    for name in alignment.objects:
        k = alignment.scene.index(name)
        if k not in contours.fitted.shapes:
            others[name] = "the pixels do not determine its pose"
        elif name not in texts:
            others[name] = programs.unchangeable.get(name, "it has no program")
        elif not (values := {c.name: c.value for c in named_constants(texts[name])}):
            others[name] = "its program has no named constants"
        else:
            px = contours.outlines.get(name)
            objects[name] = _Object(texts[name], values, contours.drawn.owner == k, px, px)
    return objects, others


def _contours(alignment: Alignment, photo: UInt8[np.ndarray, "row column 3"]) -> Contours:
    scene = alignment.scene
    assert alignment.fitted is not None and scene.camera is not None
    bins = LabImage.of(photo, WIDTH_PX, height_of(scene.camera, WIDTH_PX)).bins
    drawn = draw_scene(scene, scene.camera, WIDTH_PX)
    return Contours(alignment.fitted, drawn, bins, outline_errors(scene, photo, drawn))


def _specs(objects: Mapping[str, _Object]) -> dict[str, ObjectSpec]:
    return {name: own.spec for name, own in objects.items() if own.spec is not None}


def _proposed(
    name: str, own: _Object, contours: Contours, programs: EditablePrograms
) -> tuple[_Object, _Proposal | None]:
    """Propose a change of an object.

    Returns:
        The object, with the reason if no change is proposed, and the proposal or None.
    """
    k = contours.fitted.unknowns.scene.index(name)
    if k not in contours.fitted.shapes or not own.current:
        return own, None
    build = partial(programs.build, name)
    while True:
        further = own.changed
        candidate = best_candidate(
            contours,
            k,
            own.text,
            build,
            own.original,
            refused=own.refused,
            changed=further,
        )
        least = 0.0 if further else LEAST_GAIN
        if candidate is None or candidate.gain <= least:
            if further:
                own = replace(own, changed="")
                continue
            if significant(contours.fitted.shapes[k]) and not own.refused:
                fits = sensitivities(own.text, build)
                own = replace(own, reason=UNFAVORED if fits else NO_CONSTANT)
            return own, None
        text = with_value(own.text, candidate.constant, candidate.value)
        spec = build(text)
        proposal = (
            None if isinstance(spec, str) else _Proposal(candidate, text, spec, bool(further))
        )
        if proposal is not None:
            return own, proposal
        constant = candidate.constant.name
        own = own.without(constant, f"{constant} -> {candidate.value:.4g}: {spec}")


def _judged(
    objects: Mapping[str, _Object],
    proposals: Mapping[str, _Proposal],
    trial: Contours,
    programs: EditablePrograms,
) -> dict[str, _Object]:
    """Accept the proposals that the pixels of the new alignment favor, and return all objects."""
    judged, scene = {}, trial.fitted.unknowns.scene
    for name, own in objects.items():
        shown = trial.drawn.owner == scene.index(name)
        px = trial.outlines.get(name)
        seen = replace(own, shown=shown, outline_px=px, current=True)
        proposal = proposals.get(name)
        if proposal is None:
            judged[name] = seen
            continue
        least = 0.0 if proposal.further else LEAST_GAIN
        farther = None not in (own.outline_px, seen.outline_px) and (
            float(seen.outline_px or 0) >= float(own.outline_px or 0)
        )
        if gain(seen.shown, own.shown, trial.bins) <= least or farther:
            why = "the pixels do not favor it"
        else:
            why = programs.check(name, proposal.text)
        if why:
            refused = own.without(proposal.name, proposal.refused(why))
            judged[name] = replace(refused, current=False)
            continue
        judged[name] = replace(
            seen,
            text=proposal.text,
            spec=proposal.spec,
            edited=(*own.edited, proposal.name),
            changed="" if proposal.further else proposal.name,
        )
    return judged


def _result(
    best: FreedScene,
    objects: Mapping[str, _Object],
    others: Mapping[str, str],
    photo: UInt8[np.ndarray, "row column 3"],
) -> FreedScene:
    outlines = outline_errors(best.alignment.scene, photo)
    freed = {name: FreedObject((), reason) for name, reason in others.items()}
    for name, own in objects.items():
        values = {c.name: c.value for c in named_constants(own.text)}
        edits = tuple(
            DimensionEdit(each, own.original[each], values[each])
            for each in dict.fromkeys(own.edited)
        )
        if edits:
            freed[name] = FreedObject(edits, "", own.first_px, outlines.get(name))
        else:
            freed[name] = FreedObject((), own.reason)
    alignment = replace(best.alignment, dimensions=freed)
    texts = {name: own.text for name, own in objects.items() if own.spec is not None}
    return replace(best, alignment=alignment, texts=texts)

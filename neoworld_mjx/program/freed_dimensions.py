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

from ..estimate.alignment import Alignment, DimensionEdit, FreedObject
from ..estimate.colors import LabImage, gain
from ..estimate.outlines import outline_errors
from ..estimate.rasterize import draw_scene, height_of
from ..spec import ObjectSpec, SceneSpec
from .named_constants import (
    Candidate,
    Contours,
    best_candidate,
    named_constants,
    with_value,
)

WIDTH_PX = 640
"""Width of the image in which outlines are compared [px]."""
MIN_GAIN = 20.0
"""Smallest log likelihood ratio of the outline after a change to the outline before it [nats].

The first change of a constant is dropped if the ratio is smaller; a further change of the same
constant only needs a positive ratio. The ratio treats pixels as independent, but neighboring pixels
are not, so the limit is far above 0.
"""
STEPS = 3
"""Largest number of rounds; in each round, changes are proposed and the scene is aligned again."""


@dataclass(frozen=True)
class EditablePrograms:
    """Programs of a scene's objects, and functions that build and check edited ones."""

    texts: Mapping[str, str]
    """Program of each object that may be edited, by object name."""
    build: Callable[[str, str], ObjectSpec | str]
    """Builds an object from its name and a program; if it cannot be built, returns the reason."""
    check: Callable[[str, str], str]
    """Returns why the object with a name and a program is invalid; empty if it is valid."""


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
    repeated: bool
    """True if the constant was changed before."""

    @property
    def name(self) -> str:
        return self.candidate.constant.name


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
    refused: frozenset[str] = frozenset()
    """Names of the constants whose changes were refused."""
    current: bool = True
    """False if the last alignment was made with a shape that was refused."""

    def without(self, name: str) -> "_Object":
        return replace(self, refused=self.refused | {name}, changed="")


def free_dimensions(
    composed: SceneSpec,
    alignment: Alignment,
    photo: UInt8[np.ndarray, "row column 3"],
    programs: EditablePrograms,
    compose: Callable[[Mapping[str, ObjectSpec]], SceneSpec],
    align: Callable[[SceneSpec], Alignment],
) -> FreedScene:
    """Change dimensions of programs where the photograph contradicts them.

    Args:
        composed: the composed scene.
        alignment: the alignment of `composed`.
        photo: the photograph (sRGB).
        programs: the programs of the scene's objects.
        compose: composes the scene with some objects replaced, by name. The geometric mean of the
            edges of each replaced object is preserved.
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
    objects = _states(contours, alignment, programs)
    for _ in range(STEPS):
        proposals: dict[str, _Proposal] = {}
        for name, state in objects.items():
            objects[name], proposal = _propose(name, state, contours, programs)
            if proposal is not None:
                proposals[name] = proposal
        if not proposals:
            break
        specs = _specs(objects)
        scene = compose(specs | {name: p.spec for name, p in proposals.items()})
        trial = align(scene)
        if trial.fitted is None:
            break
        contours = _contours(trial, photo)
        objects = _accept_favored(objects, proposals, contours, programs)
        if all(objects[name].text == p.text for name, p in proposals.items()):
            best = FreedScene(scene, trial, {}, _specs(objects))
    if best.specs != _specs(objects):
        # The last alignment was made with changes that were refused.
        scene = compose(_specs(objects))
        best = FreedScene(scene, align(scene), {}, _specs(objects))
    return _result(best, objects, photo)


def _states(
    contours: Contours, alignment: Alignment, programs: EditablePrograms
) -> dict[str, _Object]:
    """Return the objects whose programs may be changed: the pixels determine their poses."""
    objects, texts = {}, programs.texts
    for name in alignment.objects:
        k = alignment.scene.index(name)
        if k in contours.fitted.shapes and name in texts:
            values = {c.name: c.value for c in named_constants(texts[name])}
            px = contours.outlines.get(name)
            objects[name] = _Object(texts[name], values, contours.rendered.owner == k, px, px)
    return objects


def _contours(alignment: Alignment, photo: UInt8[np.ndarray, "row column 3"]) -> Contours:
    scene = alignment.scene
    assert alignment.fitted is not None and scene.camera is not None
    bins = LabImage.of(photo, WIDTH_PX, height_of(scene.camera, WIDTH_PX)).bins
    rendered = draw_scene(scene, scene.camera, WIDTH_PX)
    return Contours(alignment.fitted, rendered, bins, outline_errors(scene, photo, rendered))


def _specs(objects: Mapping[str, _Object]) -> dict[str, ObjectSpec]:
    return {name: state.spec for name, state in objects.items() if state.spec is not None}


def _propose(
    name: str, state: _Object, contours: Contours, programs: EditablePrograms
) -> tuple[_Object, _Proposal | None]:
    """Propose a change of an object.

    Returns:
        The updated state of the object, and the proposal, or None.
    """
    k = contours.fitted.unknowns.scene.index(name)
    if k not in contours.fitted.shapes or not state.current:
        return state, None
    build = partial(programs.build, name)
    while True:
        repeated = state.changed
        candidate = best_candidate(
            contours,
            k,
            state.text,
            build,
            state.original,
            refused=state.refused,
            changed=repeated,
        )
        min_gain = 0.0 if repeated else MIN_GAIN
        if candidate is None or candidate.gain <= min_gain:
            if repeated:
                state = replace(state, changed="")
                continue
            return state, None
        text = with_value(state.text, candidate.constant, candidate.value)
        spec = build(text)
        if not isinstance(spec, str):
            return state, _Proposal(candidate, text, spec, bool(repeated))
        state = state.without(candidate.constant.name)


def _accept_favored(
    objects: Mapping[str, _Object],
    proposals: Mapping[str, _Proposal],
    trial: Contours,
    programs: EditablePrograms,
) -> dict[str, _Object]:
    """Accept the proposals that the pixels of the new alignment favor, and return all objects."""
    states, scene = {}, trial.fitted.unknowns.scene
    for name, state in objects.items():
        shown = trial.rendered.owner == scene.index(name)
        px = trial.outlines.get(name)
        updated = replace(state, shown=shown, outline_px=px, current=True)
        proposal = proposals.get(name)
        if proposal is None:
            states[name] = updated
            continue
        min_gain = 0.0 if proposal.repeated else MIN_GAIN
        worse = None not in (state.outline_px, updated.outline_px) and (
            float(updated.outline_px or 0) >= float(state.outline_px or 0)
        )
        unfavored = gain(updated.shown, state.shown, trial.bins) <= min_gain or worse
        if unfavored or programs.check(name, proposal.text):
            states[name] = replace(state.without(proposal.name), current=False)
            continue
        states[name] = replace(
            updated,
            text=proposal.text,
            spec=proposal.spec,
            edited=(*state.edited, proposal.name),
            changed="" if proposal.repeated else proposal.name,
        )
    return states


def _result(
    best: FreedScene,
    objects: Mapping[str, _Object],
    photo: UInt8[np.ndarray, "row column 3"],
) -> FreedScene:
    outlines = outline_errors(best.alignment.scene, photo)
    dimensions = {}
    for name, state in objects.items():
        if not state.edited:
            continue
        values = {c.name: c.value for c in named_constants(state.text)}
        edits = tuple(
            DimensionEdit(constant, state.original[constant], values[constant])
            for constant in dict.fromkeys(state.edited)
        )
        dimensions[name] = FreedObject(edits, state.first_px, outlines.get(name))
    alignment = replace(best.alignment, dimensions=dimensions)
    texts = {name: state.text for name, state in objects.items() if state.spec is not None}
    return replace(best, alignment=alignment, texts=texts)

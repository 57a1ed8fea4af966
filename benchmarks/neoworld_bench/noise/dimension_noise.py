"""Wrong dimensions of programs: every edge of every object is too long or too short by WRONG.

The sign of each error is random. Equal edges of an object have the same sign, because a model
recognizes round and square objects. The text of the program contains the wrong edges, so that it
can be edited.
"""

import zlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from neoworld_mjx.program.freed_dimensions import EditablePrograms
from neoworld_mjx.program.sandbox import build, run
from neoworld_mjx.spec import ObjectSpec, scale
from neoworld_mjx.spec.kinematics import recentred
from neoworld_mjx.templates import Template
from neoworld_mjx.templates.template import BOX

from ..dataset.declaration import ObjectDeclaration, Value, template_of
from .parse_noise import NoiseLog

WRONG = 0.1
"""Relative error of an edge."""
TRIES = 8
"""Maximum number of samples of the signs until a program passes the checks. There are eight
combinations of signs."""


class WrongDimensions(NamedTuple):
    """A program with wrong edges, and the object that it builds at the scale of the scene."""

    text: str
    spec: ObjectSpec
    factor: float
    """Scale of the object in the scene."""


def with_wrong_dimensions(item: ObjectDeclaration, number: int, log: NoiseLog) -> WrongDimensions:
    """Return the program of an object with edges that are wrong by WRONG.

    If no sample passes the checks, the program is correct, and "dimensions" is added to the refused
    errors of the log.

    Args:
        item: the true declaration of the object.
        number: seed of the noise. The noise of each object also depends on its name.
        log: log of errors.
    """
    rng = np.random.default_rng((number, 51, zlib.crc32(item.name.encode())))
    template = template_of(item)
    for _ in range(TRIES):
        text = template.program(_with_wrong_edges(template, item.set, rng))
        built = build(text)
        if built.ok and built.spec is not None:
            return WrongDimensions(text, _scaled_and_recentred(built.spec, item.scale), item.scale)
    log.refused.append("dimensions")
    text = template.program(item.set)
    built = build(text)
    assert built.spec is not None
    return WrongDimensions(text, _scaled_and_recentred(built.spec, item.scale), item.scale)


def _with_wrong_edges(
    template: Template, true_values: Mapping[str, Value], rng: np.random.Generator
) -> dict[str, Value]:
    """Return a program's parameters with wrong edges, clipped to the parameters' ranges."""
    values: dict[str, Value] = {name: p.default for name, p in template.parameters.items()}
    values |= true_values
    factors: dict[Value, float] = {}
    for name in BOX:
        value, parameter = values[name], template.parameters[name]
        assert not isinstance(value, str)
        factor = 1 + WRONG * float(rng.choice((-1.0, 1.0)))
        wrong = value * factors.setdefault(value, factor)
        values[name] = min(max(wrong, parameter.low), parameter.high)
    return values


def _scaled_and_recentred(spec: ObjectSpec, factor: float) -> ObjectSpec:
    return scale(recentred(spec), factor)


def editable(programs: Mapping[str, WrongDimensions]) -> EditablePrograms:
    """Return the programs in the form that `program.freed_dimensions.free_dimensions` takes.

    Args:
        programs: programs of the objects, by name.
    """

    def object_of(name: str, text: str) -> ObjectSpec | str:
        ran = run(text)
        if ran.spec is None:
            return "; ".join(signal.phrase() for signal in ran.signals)
        return _scaled_and_recentred(ran.spec, programs[name].factor)

    def check(name: str, text: str) -> str:
        built = build(text)
        return "" if built.ok else "; ".join(signal.phrase() for signal in built.signals)

    return EditablePrograms(
        {name: program.text for name, program in programs.items()}, object_of, check
    )

"""Scenes that other rooms ask for by name, with where a search starts and what the truth is."""

from collections.abc import Callable
from typing import Any

from ..errors import SpecError, choices
from .refine_scenes import LARGE, SCENES, errors, photographed, start
from .scenes import crowded


def named() -> dict[str, Callable[[str], dict[str, Any]]]:
    """Return what makes scenes, by kind: `bench:tower` is made by "bench" from "tower".

    Each returns the scene's name, the scene, and where there are such: "start", of a compiled scene
    and a seed, and "errors", of a compiled scene and a layout.
    """
    return {"bench": _bench, "crowded": _crowded}


def _bench(name: str) -> dict[str, Any]:
    every = SCENES | LARGE
    if name not in every:
        raise SpecError(f"scene bench:{name}: {choices(name, every)}")
    scene = photographed(name)
    return {"name": f"bench:{name}", "scene": scene, "start": start, "errors": errors}


def _crowded(objects: str) -> dict[str, Any]:
    if not objects.isdecimal() or not 1 <= int(objects) <= 100:
        raise SpecError(f"scene crowded:{objects}: name a number of objects from 1 to 100")
    return {"name": f"crowded:{objects}", "scene": crowded(int(objects)), "start": start}

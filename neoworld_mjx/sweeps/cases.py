"""Scenes of a sweep: from files, from run folders, or by name from a source."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from ..errors import SpecError, choices
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..refinement.scene_refinement import read_composed
from ..spec import SceneSpec

PHOTO = "photo.png"
"""Name of the photograph in a run folder."""


@dataclass(frozen=True)
class Case:
    """A scene to refine."""

    name: str
    scene: SceneSpec
    start: Callable[[SceneModel, int], Layout] | None = None
    """Function that returns the initial layout for a seed, with a population axis of length 1.

    If None, the search starts at the composed scene."""
    errors: Callable[[SceneSpec], dict[str, float]] | None = None
    """Function that returns the errors of a delivered scene; None if there is no ground truth."""
    photo: Path | None = None
    """File of the photograph, for S_photo and for S_sem by a model; None if there is none."""


Source = Callable[[str], Case]
"""Function that returns the scene KIND:NAME, given NAME."""
SOURCES = "neoworld_bench.named_scenes:SOURCES"
"""Import path of the benchmark's sources of scenes."""


def bench_sources() -> Mapping[str, Source]:
    """Return the sources of named scenes, by kind: `bench`, `crowded` and `photo`."""
    module, name = SOURCES.split(":")
    return getattr(import_module(module), name)


def case(name: str, sources: Mapping[str, Source] | None = None) -> Case:
    """Return a scene by name: KIND:NAME, or the path of a scene.json or of a run folder.

    The scene of a run folder is the composed scene, before refinement.

    Args:
        name: the name or path of the scene.
        sources: functions that return scenes, by KIND. If None, the result of `bench_sources`.

    Raises:
        SpecError: the scene does not exist.
    """
    sources = bench_sources() if sources is None else sources
    kind, colon, inner = name.partition(":")
    if colon and kind in sources:
        return sources[kind](inner)
    path = Path(name)
    if not path.exists():
        if colon:
            raise SpecError(f"scene {name}: {choices(kind, sources)}, or the path of a file")
        kinds = ", ".join(f"{kind}:NAME" for kind in sources)
        generated = f", nor is it one of {kinds}" if kinds else ""
        raise SpecError(f"scene {name}: no such file or folder{generated}")
    photo = path / PHOTO
    return Case(name, read_composed(path), photo=photo if photo.is_file() else None)

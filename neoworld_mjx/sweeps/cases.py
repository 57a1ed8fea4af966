"""The scenes of a sweep: files, run folders, and scenes that a program makes by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import SpecError, choices
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..refinement.scene_refinement import read_composed
from ..spec import SceneSpec

PHOTO = "photo.png"
"""Where a run folder keeps its photograph."""


@dataclass(frozen=True)
class Case:
    """A scene to search."""

    name: str
    scene: SceneSpec
    start: Callable[[SceneModel, int], Layout] | None = None
    """Gives the layout at which the search with a seed starts, pop axis of length 1.

    None starts at the composed scene."""
    errors: Callable[[SceneModel, Layout], dict[str, float]] | None = None
    """Measures the errors of a layout from the truth; None where that is unknown."""
    photo: Path | None = None
    """The photograph's file, for scores by a model; None without one."""


Source = Callable[[str], Case]
"""Makes a scene from the name after the colon."""


def case(name: str, sources: Mapping[str, Source]) -> Case:
    """Find a scene: KIND:NAME of a source, else a scene.json or run folder.

    A run folder gives the scene as composed, before it was refined.

    Raises:
        SpecError: there is no such scene.
    """
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

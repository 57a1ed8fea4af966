"""Reconstructions of a view: the stages of run folders, and scenes of other methods.

RUNS/NAME/composed.json | compose/scene.json     composed; aligned if compose/align.json is there
RUNS/NAME/aligned.json, RUNS/NAME/scene.json     aligned, and refined
SUBMISSION/NAME/scene.json | scene.glb | ...     another method's, as `methods.submission` reads it
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from neoworld_mjx.errors import SpecError
from neoworld_mjx.export.read_mesh_scene import FileCamera
from neoworld_mjx.io import read_model
from neoworld_mjx.spec import SceneSpec, Spec, read_scene
from neoworld_mjx.spec.base import Name

from ..methods.submission import FILES, read_scene_file, scene_file, submission_name

OURS, SUBMITTED = "ours", "submitted"
STAGES = (
    ("composed", "composed.json"),
    ("composed", "compose/scene.json"),
    ("aligned", "aligned.json"),
    ("refined", "scene.json"),
)
"""Stage of a run and its file; of several files of a stage the first counts."""
ALIGNED = "compose/align.json"
MATCHES = "matches.json"
"""Optional file next to a reconstruction: names of its objects, and those of the ground truth."""


class ObjectMatches(Spec):
    """Pairs of a reconstructed and a true object."""

    matches: dict[Name, str]


@dataclass(frozen=True)
class MadeView:
    """A reconstruction of a view at one stage."""

    method: str
    stage: str
    scene: SceneSpec
    matches: dict[str, str]
    """Name of the true object by that of the scene's; empty where names or the image decide."""
    notes: tuple[str, ...] = ()
    """Additions and omissions of the reader, such as colliders that it made."""
    camera: FileCamera | None = None
    """Camera in the scene's world, if the file of a scene without one states it."""


def run_views(runs: Sequence[Path], name: str) -> Iterator[MadeView]:
    """Read the stages of the run of a view; none where no folder has it.

    Args:
        runs: run folders named after their views, or folders of such folders.
        name: of the view.

    Raises:
        SpecError: a scene cannot be read.
    """
    for folder in _folders(runs, name):
        stages = set()
        for stage, file in STAGES:
            stage = "aligned" if file.startswith("compose/") and _is_aligned(folder) else stage
            if stage in stages or not (folder / file).is_file():
                continue
            stages.add(stage)
            yield MadeView(OURS, stage, read_scene(folder / file), _matches(folder))


def submitted_view(submission: Path, name: str) -> MadeView | None:
    """Read another method's scene of a view; None where it has none.

    Raises:
        SpecError: it cannot be read.
    """
    folder = next(iter(_folders([submission], name)), None)
    if folder is None:
        return None
    file = scene_file(folder)
    if file is None:
        raise SpecError(f"submission: {folder} has none of {', '.join(FILES)}")
    read, label = read_scene_file(file), submission_name(submission)
    return MadeView(label, SUBMITTED, read.spec, _matches(folder), read.notes, read.camera)


def folder_names(roots: Sequence[Path]) -> list[str]:
    """Return the names that views may have: of the folders, and of those within them.

    Raises:
        SpecError: a folder does not exist.
    """
    names = []
    for root in roots:
        if not root.is_dir():
            raise SpecError(f"{root} is no folder")
        names += [root.resolve().name]
        names += sorted(folder.name for folder in root.iterdir() if folder.is_dir())
    return list(dict.fromkeys(names))


def _folders(roots: Sequence[Path], name: str) -> list[Path]:
    places = [root if root.resolve().name == name else root / name for root in roots]
    return [place for place in places if place.is_dir()]


def _is_aligned(folder: Path) -> bool:
    return (folder / ALIGNED).is_file()


def _matches(folder: Path) -> dict[str, str]:
    file = folder / MATCHES
    if not file.is_file():
        return {}
    return dict(read_model(file, ObjectMatches, SpecError, "a list of matches").matches)

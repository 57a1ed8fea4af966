"""Recorded runs whose scene is placed anew, with what a data set knows about the view.

RUNS/NAME/photo.png, tree.json               the photograph, and the tree of Step 1
RUNS/NAME/objects/OBJECT/spec.json           or program.py, which is built
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from neoworld_mjx.config import Config
from neoworld_mjx.errors import SpecError
from neoworld_mjx.evidence.depth_image import DepthImage
from neoworld_mjx.evidence.evidence import Evidence, PhotoPixels
from neoworld_mjx.evidence.known_camera import KnownCamera
from neoworld_mjx.io import read_model
from neoworld_mjx.io.text_files import read_untrusted_text
from neoworld_mjx.parse.photo import load_photo
from neoworld_mjx.pipeline.place import place, refine_placed
from neoworld_mjx.program import build
from neoworld_mjx.spec import ObjectSpec, SceneSpec, SceneTree

from ..suites import KnownView
from .true_views import TrueView


@dataclass(frozen=True)
class MadeView:
    """A reconstruction of a view at one stage, such as composed, aligned or refined."""

    stage: str
    scene: SceneSpec


def placed_views(
    view: TrueView, run: Path, known: Sequence[KnownView], config: Config
) -> Iterator[MadeView]:
    """Place and refine the objects of a run (Steps 4 and 5), once for each of `known`.

    Yields the scene of either step.

    Args:
        view: the view with its camera and depth.
        run: folder of the run.
        known: what is known: the photo alone, the camera, or camera and depth.
        config: options.

    Raises:
        SpecError: a file cannot be read, a program builds no object, or the view has no depth.
    """
    if not known:
        return
    tree = read_model(run / "tree.json", SceneTree, SpecError, "a scene tree")
    objects = {node.name: _object(run / "objects" / node.name, config) for node in tree.nodes}
    photo = load_photo(run / "photo.png", config.parse.max_side_px).rgb
    for kind in known:
        evidence = evidence_of_view(view, photo, kind)
        placed = place(tree, objects, evidence, config.compose, name=view.name)
        yield MadeView(f"placed, {kind}", placed.scene)
        refined = refine_placed(
            placed.scene,
            config.refine,
            seed=config.seed,
            photo=photo,
            again=config.compose.align,
            evidence=evidence,
        )
        yield MadeView(f"refined, {kind}", refined.scene)


def evidence_of_view(view: TrueView, photo: PhotoPixels, known: KnownView) -> Evidence:
    """Return a photograph with the camera of a view, or with its camera and depth.

    The pixels are taken as squares.

    Raises:
        SpecError: depth is wanted and the view has none.
    """
    if known == "photo":
        return Evidence(photo)
    height, width = photo.shape[:2]
    width, height = view.size or (width, height)
    fx, fy, cx, cy = view.camera
    camera = KnownCamera(
        (width, height),
        focal=float(np.sqrt(fx * fy)),
        principal=(cx + 0.5 - width / 2, cy + 0.5 - height / 2),
    )
    if known == "camera":
        return Evidence(photo, camera)
    if view.depth is None:
        raise SpecError(f"{view.name} has no depth image")
    depth = np.where(view.depth > 0, view.depth, np.nan)
    return Evidence(photo, camera, DepthImage(depth))


def _object(folder: Path, config: Config) -> ObjectSpec:
    if (folder / "spec.json").is_file():
        return read_model(folder / "spec.json", ObjectSpec, SpecError, "an object")
    file = folder / "program.py"
    built = build(read_untrusted_text(file, SpecError, "a program"), config.program)
    if built.spec is None:
        raise SpecError(f"{file}: {'; '.join(signal.phrase() for signal in built.signals[:3])}")
    return built.spec

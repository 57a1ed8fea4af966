"""Where methods start: the truth disturbed as answers are, fitted and composed as a run does it.

Every start of every scene has noise of its own, from `photo_answers`, which measured answers set.
Programs are the true shapes; their sizes are what composition makes of the answer's boxes.
"""

import zlib
from typing import Literal

from ...compose.compose import compose
from ...config import ComposeOptions
from ...parse.fit import fit_tree
from ...parse.refit import refit_tree
from ...spec import SceneSpec, SceneTree
from ..photo_answers import disturbed_answer, exact_answer
from ..photo_scenes import see
from .declaration import SceneDeclaration
from .truth_scene import truth_scene

NoiseLevel = Literal["exact", "layout"]
"""Noise of a start: none, or positions, headings, sizes, camera and 2D boxes."""
EVALUATION = 1
"""Starts whose number is odd are the evaluation half: no default is tuned on them."""


def photographed(declared: SceneDeclaration) -> SceneSpec:
    """Return a declared scene with what its camera sees: visible boxes, depths, hidden flags."""
    return see(truth_scene(declared), finer=2)


def true_tree(scene: SceneSpec) -> SceneTree:
    """Return the parse that says of a photographed scene what is true."""
    return exact_answer(scene)


def noise_number(name: str, seed: int, start: int) -> int:
    """Return the number that seeds the noise of a start; no two starts share it."""
    return zlib.crc32(f"{name}/{seed}/{start}".encode())


def composed_start(
    scene: SceneSpec,
    tree: SceneTree,
    number: int,
    options: ComposeOptions | None = None,
    *,
    noise: NoiseLevel = "layout",
) -> SceneSpec:
    """Return the scene that a run would compose from a disturbed answer.

    Args:
        scene: the truth, as photographed.
        tree: its exact answer.
        number: of the noise.
        options: of composition.
        noise: its level.
    """
    o = options or ComposeOptions()
    shapes = {item.name: item.spec for item in scene.objects}
    answer = tree if noise == "exact" else disturbed_answer(tree, number)
    fitted, _ = fit_tree(answer)
    again = refit_tree(fitted, shapes)[0] if o.refit else fitted
    return compose(again, shapes, o, name=scene.name).scene


def is_evaluation(start: int) -> bool:
    """Tell whether a start is of the evaluation half."""
    return start % 2 == EVALUATION

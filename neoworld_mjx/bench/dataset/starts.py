"""Where methods start: the truth disturbed as answers are, fitted and composed as a run does it.

Every start of every scene has noise of its own, with spreads and rates of measured answers: of the
numbers of a parse (`photo_answers`), of its tree (`parse_noise`), of programs (`program_noise`,
`joint_noise`). Sizes are what composition makes of the answer's boxes.
"""

import zlib
from typing import Literal

from ...compose.compose import compose
from ...config import ComposeOptions
from ...parse.fit import fit_tree
from ...parse.refit import refit_tree
from ...spec import ObjectSpec, SceneSpec, SceneTree
from ..photo_answers import disturbed_answer, exact_answer
from ..photo_scenes import see
from .declaration import SceneDeclaration, declaration
from .parse_noise import NoiseLog, wrong_parse
from .program_noise import wrong_program
from .truth_scene import truth_scene

NoiseLevel = Literal["exact", "layout", "parse", "programs", "all"]
"""Noise of a start: none; the numbers of a parse; these and its tree; these and the programs;
everything."""
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
    noise: NoiseLevel = "all",
    log: NoiseLog | None = None,
) -> SceneSpec:
    """Compose a scene from a disturbed answer, as a run would.

    Args:
        scene: the truth, as photographed; where programs have noise, objects of a scene of the
            benchmark.
        tree: its exact answer.
        number: of the noise. All levels of one number have the same noise in the answer's numbers.
        options: of composition.
        noise: its level.
        log: to which the errors beside the numbers are added.
    """
    o, log = options or ComposeOptions(), log or NoiseLog()
    fitted = tree if noise == "exact" else disturbed_answer(tree, number)
    shapes, programs = {item.name: item.spec for item in scene.objects}, NoiseLog()
    if noise in ("programs", "all"):
        shapes |= wrong_shapes(scene, number, programs)
    if noise in ("parse", "all"):
        parsed = wrong_parse(fitted, number, log, shapes)
        fitted = parsed.tree
        shapes |= parsed.shapes
    log.injected += programs.injected
    log.refused += programs.refused
    if noise != "exact":
        # A fit would only move what is right, by up to some millimetres.
        fitted, _ = fit_tree(fitted)
        fitted = refit_tree(fitted, shapes)[0] if o.refit else fitted
    return compose(fitted, shapes, o, name=scene.name).scene


def wrong_shapes(scene: SceneSpec, number: int, log: NoiseLog) -> dict[str, ObjectSpec]:
    """Return the movable objects of a scene as a programmer would make them.

    Args:
        scene: a scene of the benchmark, or some of its objects.
        number: of the noise.
        log: of the errors.
    """
    names = {item.name for item in scene.objects}
    shapes = {}
    for item in declaration(scene.name).movable():
        if item.name in names:
            links = (o.parent_link for o in scene.objects if o.parent == item.name)
            carriers = frozenset(link for link in links if link is not None)
            shapes[item.name] = wrong_program(item, number, carriers, log)
    return shapes


def is_evaluation(start: int) -> bool:
    """Tell whether a start is of the evaluation half."""
    return start % 2 == EVALUATION

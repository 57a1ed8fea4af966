"""Initial scenes: the ground truth with the errors of responses, composed as in a run.

Each initial scene has different noise. Deviations and rates of the noise were measured. There are
errors of

- the numbers of a response (`rendered_responses`),
- its supports and its tree (`parse_noise`),
- programs (`program_noise`, `joint_noise`).

Composition derives the sizes of objects from the boxes of the response.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from neoworld_mjx.config import AlignOptions, ComposeOptions, ParseOptions
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.parse.checks import SceneIssue, check_score, check_tree
from neoworld_mjx.pipeline.place import LayoutEstimate, place
from neoworld_mjx.spec import ObjectSpec, SceneSpec, SceneTree

from ..dataset.declaration import declaration
from ..fidelity.rendered_responses import noisy_response, with_boxes_redrawn
from .parse_noise import NoiseLog, refusals, with_other_supports, wrong_parse
from .program_noise import wrong_program

NoiseLevel = Literal["exact", "layout", "parse", "programs", "all"]
"""Noise of an initial scene.

- exact: no noise.
- layout: the numbers of the response.
- parse: layout, and the tree of the response.
- programs: layout, and the programs.
- all: parse and programs.
"""
EVALUATION = 1
"""Initial scenes with odd numbers are the evaluation half, on which no default is tuned."""


def noise_number(name: str, seed: int, start: int) -> int:
    """Return the seed of the noise of an initial scene."""
    return zlib.crc32(f"{name}/{seed}/{start}".encode())


@dataclass(frozen=True)
class InitialScene:
    """A noisy response with the programs' objects, from which Step 4 starts."""

    tree: SceneTree
    """The response."""
    objects: Mapping[str, ObjectSpec]
    """Object of every node, by name."""
    name: str
    options: ComposeOptions

    @cached_property
    def scene(self) -> SceneSpec:
        """The composed scene, before an alignment."""
        return self.placed().composed.scene

    def placed(
        self,
        evidence: Evidence | None = None,
        align: AlignOptions | None = None,
    ) -> LayoutEstimate:
        """Compose and align the scene as a run does; see `pipeline.place.place`.

        Args:
            evidence: the photograph, without which the scene is not aligned, and what is known.
            align: options of the alignment; by default, those of `options`.
        """
        options = self.options
        if align is not None:
            options = options.model_copy(update={"align": align})
        return place(self.tree, self.objects, evidence, options, name=self.name)


def initial_scene(
    scene: SceneSpec,
    tree: SceneTree,
    number: int,
    options: ComposeOptions | None = None,
    *,
    noise: NoiseLevel = "all",
    log: NoiseLog | None = None,
) -> InitialScene:
    """Compose a scene from a noisy response, as in a run.

    Args:
        scene: the ground truth, as photographed. If programs have noise, it must contain only
            objects of a scene of the benchmark.
        tree: exact response for the scene.
        number: seed of the noise. For one number, all levels have the same noise in the response's
            numbers.
        options: options of composition.
        noise: level of the noise.
        log: log to which the errors of the tree and of programs are added.

    Returns:
        The scene.
    """
    o, log = options or ComposeOptions(), log or NoiseLog()
    shapes, programs = {item.name: item.spec for item in scene.objects}, NoiseLog()
    if noise in ("programs", "all"):
        shapes |= wrong_shapes(scene, number, programs)
    response = tree
    # Its 2D boxes would move the objects of an exact response by up to some millimeters.
    if noise == "exact":
        o = o.model_copy(update={"refit": False})
    else:
        wrong_tree = noise in ("parse", "all")
        revised = revised_response(tree, number, shapes, wrong_tree=wrong_tree)
        log.injected += revised.log.injected
        log.refused += revised.log.refused
        shapes |= revised.shapes
        response = revised.tree
    log.injected += programs.injected
    log.refused += programs.refused
    return InitialScene(response, shapes, scene.name, o)


@dataclass(frozen=True)
class RevisedResponse:
    """A response with a list of its errors."""

    tree: SceneTree
    shapes: dict[str, ObjectSpec]
    """Specs of the objects that are not in the ground truth, by name."""
    log: NoiseLog
    """Errors that are not errors of numbers."""
    issues: tuple[SceneIssue, ...]
    """Issues that the checks of Step 1 find."""

    @property
    def score(self) -> float:
        """Score by which Step 1 selects the best response."""
        return check_score(self.tree, self.issues)


def revised_response(
    tree: SceneTree, number: int, shapes: dict[str, ObjectSpec], *, wrong_tree: bool
) -> RevisedResponse:
    """Return a noisy response that is revised and selected as in Step 1.

    As long as rounds remain, the boxes of objects that the checks refuse are sampled again. The
    response with the best score is returned.

    Args:
        tree: the exact response.
        number: seed of the noise.
        shapes: specs of its objects, by name.
        wrong_tree: if True, the tree has errors, too.
    """
    response = with_other_supports(noisy_response(tree, number), tree, number)
    attempts = [_attempt(response, number, shapes, wrong_tree)]
    known = refusals(check_tree(tree))
    for _ in range(ParseOptions().critic_rounds):
        last = attempts[-1]
        refused = {name for name, _ in refusals(last.issues) - known}
        # Objects that are not in the ground truth have no true box to sample from.
        names = refused & {node.name for node in response.nodes if not node.environment}
        if not names:
            break
        response = with_boxes_redrawn(response, tree, names, number)
        attempts.append(_attempt(response, number, shapes, wrong_tree))
    return max(attempts, key=lambda attempt: attempt.score)


def _attempt(
    response: SceneTree, number: int, shapes: dict[str, ObjectSpec], wrong_tree: bool
) -> RevisedResponse:
    log, new_shapes = NoiseLog(), dict[str, ObjectSpec]()
    if wrong_tree:
        parsed = wrong_parse(response, number, log, shapes)
        response, new_shapes = parsed.tree, parsed.shapes
    return RevisedResponse(response, new_shapes, log, check_tree(response))


def wrong_shapes(scene: SceneSpec, number: int, log: NoiseLog) -> dict[str, ObjectSpec]:
    """Return the specs of a scene's movable objects with errors of programs, by name.

    Args:
        scene: a scene of the benchmark, or some of its objects.
        number: seed of the noise.
        log: log to which errors are added.
    """
    names = {item.name for item in scene.objects}
    shapes = {}
    for item in declaration(scene.name).movable():
        if item.name in names:
            links = (o.parent_link for o in scene.objects if o.parent == item.name)
            parents = frozenset(link for link in links if link is not None)
            shapes[item.name] = wrong_program(item, number, parents, log)
    return shapes


def is_evaluation(start: int) -> bool:
    """Return True if an initial scene is in the evaluation half."""
    return start % 2 == EVALUATION

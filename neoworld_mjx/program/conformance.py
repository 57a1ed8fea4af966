"""Compare an object with the parse: its box, its movable parts, and what a revision lost."""

import ast
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from ..spec import ObjectSpec, TreeNode, bounds
from ..spec.opening import parsed_state
from .signals import Signal

PROPORTION_WARNS, PROPORTION_FAILS = 0.08, 0.25
"""Deviation of an edge, over the parsed one, after the best uniform scale."""
SIZE_WARNS, SIZE_FAILS = 0.15, 1.0
"""Deviation of the size as a whole, over the parsed one; it will be scaled, walls and all."""


def fit(spec: ObjectSpec, node: TreeNode) -> Iterator[Signal]:
    """Yield the differences between an object and its node of the parse."""
    # The parse measures what it sees: parts that stand open stand open in its box, too.
    state, _ = parsed_state(spec, node)
    low, high = bounds(spec, state)
    made, given = high - low, np.array(node.box3d.size)
    factor = float(np.exp(np.mean(np.log(given / made))))
    edges = made * factor / given - 1
    worst = int(np.argmax(np.abs(edges)))
    if abs(edges[worst]) > PROPORTION_WARNS:
        shown = " x ".join(f"{v:.3f}" for v in made)
        asked = " x ".join(f"{v:.3f}" for v in given)
        yield Signal(
            severity="error" if abs(edges[worst]) > PROPORTION_FAILS else "warning",
            code="proportions",
            message=f"the object{_opened(node)} measures {shown} m, "
            f"the box in the photo {asked} m; {'xyz'[worst]} is too "
            f"{'large' if edges[worst] > 0 else 'small'} for the others",
            value=float(edges[worst]),
            threshold=PROPORTION_WARNS,
            hint="fill the given box in all three directions; is the front at +x?",
        )
    off = max(factor, 1 / factor) - 1
    if off > SIZE_WARNS:
        yield Signal(
            severity="error" if off > SIZE_FAILS else "warning",
            code="wrong_size",
            message=f"the object is {1 / factor:.3g} times as large as the box in the photo",
            value=1 / factor,
            threshold=1.0 + SIZE_WARNS,
            hint="write it at the given size, in metres",
        )
    moving = [joint for joint in spec.joints if joint.type != "fixed"]
    kinds = Counter("prismatic" if j.type == "prismatic" else "turning" for j in moving)
    asked = Counter("prismatic" if s.type == "prismatic" else "turning" for s in node.articulation)
    for kind, count in asked.items():
        if kinds[kind] < count:
            names = [
                s.part for s in node.articulation if (s.type == "prismatic") == (kind[0] == "p")
            ]
            yield Signal(
                severity="error",
                code="missing_joint",
                message=f"the photo shows {count} {kind} parts ({', '.join(names)}), "
                f"the program has {kinds[kind]}",
                value=kinds[kind],
                threshold=count,
                hint="make each a part of that name, with its joint",
            )


def _opened(node: TreeNode) -> str:
    parts = [f"{part.part} {part.opening:.0%}" for part in node.articulation if part.opening > 0]
    return f", with {', '.join(parts)} open as in the photo," if parts else ""


def losses(before: ObjectSpec, after: ObjectSpec, removed: Sequence[str]) -> Iterator[Signal]:
    """Yield what an earlier round had and this one has not, unless it says so.

    A part or joint that merely changed its name is not lost: counts decide.
    """
    kinds = (
        ("part", [part.name for part in before.parts], [part.name for part in after.parts]),
        *(
            (
                f"{kind} joint",
                [joint.name for joint in before.joints if joint.type == kind],
                [joint.name for joint in after.joints if joint.type == kind],
            )
            for kind in ("revolute", "continuous", "prismatic")
        ),
    )
    said = " ".join(removed)
    for what, old, new in kinds:
        gone = [name for name in old if name not in new and name not in said]
        short = len(old) - len(new) - sum(name in said for name in old if name not in new)
        if short > 0 and gone:
            yield Signal(
                severity="error",
                code="lost",
                message=f"the earlier program had {what} {', '.join(gone)}, this one has not",
                value=len(new),
                threshold=len(old),
                hint="put it back, or name it in `removed` if it was wrong",
            )


def lost_checks(before: str, after: str, removed: Sequence[str]) -> Iterator[Signal]:
    """Yield a signal when a program dropped `assert` statements without saying so."""
    old, new = _asserts(before), _asserts(after)
    if new < old and not any("assert" in said for said in removed):
        yield Signal(
            severity="error",
            code="lost",
            message=f"the earlier program had {old} assert statements, this one has {new}",
            value=new,
            threshold=old,
            hint="put them back, or say `assert` in `removed` if they were wrong",
        )


def _asserts(program: str) -> int:
    try:
        return sum(isinstance(node, ast.Assert) for node in ast.walk(ast.parse(program)))
    except (SyntaxError, ValueError, RecursionError):
        return 0

"""Checks of an object whose parts are not joined yet: the first of the paper's three programs."""

from ..checks.compile_checks import loose_shapes, too_intricate, with_line
from ..checks.overlap import rest_overlap_signals
from ..checks.part_distances import OutOfTime, Probe
from ..checks.plausibility import plausibility
from ..checks.signals import Signal, deduplicated
from ..config import ProgramOptions
from ..spec import ObjectSpec, TreeNode
from .conformance import fit

_ABOUT_JOINTS = ("missing_joint",)
_ABOUT_SIZE = ("proportions", "wrong_size")


def check_geometry(
    spec: ObjectSpec, options: ProgramOptions, lines: dict[str, int]
) -> tuple[Signal, ...]:
    """Check that shapes of a part hang together, that no two parts overlap, and sizes and masses.

    Args:
        spec: the object, its parts fastened to the first for want of joints.
        options: thresholds.
        lines: the program's line of each part, as in `Built.lines`.
    """
    signals = list(plausibility(spec))
    try:
        probe = Probe(spec, options.check_timeout_s)
        # What a part hangs on is up to the articulation program.
        signals += [s for s in loose_shapes(probe, options) if s.code != "detached_part"]
        signals += rest_overlap_signals(probe, options)
    except OutOfTime:
        signals.append(too_intricate(options))
    return deduplicated(with_line(signal, lines) for signal in signals)


def fit_geometry(spec: ObjectSpec, node: TreeNode) -> list[Signal]:
    """Return the differences between parts without joints and the node of the parse.

    A box that was measured with parts open cannot be compared before these have joints.
    """
    opened = any(part.opening for part in node.articulation)
    skipped = (*_ABOUT_JOINTS, *(_ABOUT_SIZE if opened else ()))
    signals = [signal for signal in fit(spec, node) if signal.code not in skipped]
    if len(spec.parts) - 1 < len(node.articulation):
        names = ", ".join(part.part for part in node.articulation)
        signals.append(
            Signal(
                severity="error",
                code="missing_part",
                message=f"the photo shows moving parts ({names}), the program makes "
                f"{len(spec.parts)} part{'s' * (len(spec.parts) != 1)} in all",
                value=len(spec.parts),
                threshold=len(node.articulation) + 1,
                hint="make each moving part a part of that name, beside what it moves against",
            )
        )
    return signals

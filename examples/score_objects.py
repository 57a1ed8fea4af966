"""Hold object programs against the truth: joints and surfaces, each object and all together.

    uv run python examples/score_objects.py examples/objects truth

PROGRAMS is a program or a folder of them, TRUTH a folder with `<name>.json` for each (its format is
in docs/objects.md) and, if there is one, `<name>.npz` with surface samples. Objects without a truth
are
named and left out. The paper's row stands below, for comparison only.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neoworld_mjx.errors import NeoWorldError, SpecError
from neoworld_mjx.measure import (
    GeometryMeasure,
    JointMeasure,
    canonical_points,
    geometry_measure,
    joint_measure,
    pooled,
    read_truth,
)
from neoworld_mjx.program import build

HEAD = (
    "| object | true | made | hits | extra | correct | miss % | type % all | type % hits "
    "| axis deg (n) "
    "| pivot (n) | limits (n) | CD x10 | F .01 | F .05 | CD x10 raw | F .05 raw | scale |"
)
PAPER = (
    "| NeoWorld-Pro (theirs, Tables 1 and 2) | 245 | 268 | 216 | - | - | 11.83 | 18.78 | - "
    "| 28.52 | 0.19 "
    "| - | 0.1809 | 25.77 | 67.06 | - | - | - |"
)
NOTE = (
    "The paper's row is of 245 joints of other objects. It decides a hit by showing a multimodal "
    "model\n"
    "paired videos, and does not say how surfaces are normalised; ours is decided by geometry. The "
    "two\n"
    "are not the same measure."
)


def score(program: Path, truth_folder: Path) -> tuple[JointMeasure, GeometryMeasure | None]:
    """Build a program and measure it."""
    built = build(program.read_text(encoding="utf-8"))
    if built.spec is None:
        raise SpecError(f"{program}: {'; '.join(signal.phrase() for signal in built.signals)}")
    truth = read_truth(truth_folder / f"{program.stem}.json")
    joints = joint_measure(built.spec, truth).model_copy(update={"name": program.stem})
    samples = truth_folder / f"{program.stem}.npz"
    if not samples.exists():
        return joints, None
    with np.load(samples) as file:
        points = canonical_points(file["points"], truth)
    return joints, geometry_measure(built.spec, points)


def row(joints: JointMeasure, geometry: Sequence[GeometryMeasure]) -> str:
    """Write one line of the table; surfaces as the mean over objects."""

    def share(value: float | None) -> str:
        return "-" if value is None else f"{100 * value:.2f}"

    def mean(what: object, digits: int) -> str:
        value, n = what.value, what.n  # pyright: ignore[reportAttributeAccessIssue]
        return f"- ({n})" if value is None else f"{value:.{digits}f} ({n})"

    def surface(values: list[float], digits: int) -> str:
        return f"{np.mean(values):.{digits}f}" if values else "-"

    cells = [
        joints.name,
        *map(str, (joints.total, joints.predicted, joints.hits, len(joints.extra), joints.correct)),
        share(joints.miss),
        share(joints.type_error),
        share(joints.type_error_hits),
        mean(joints.axis_deg, 2),
        mean(joints.pivot, 3),
        mean(joints.limits, 2),
        surface([g.aligned.chamfer_x10 for g in geometry], 4),
        surface([g.aligned.f_01 for g in geometry], 1),
        surface([g.aligned.f_05 for g in geometry], 1),
        surface([g.unaligned.chamfer_x10 for g in geometry], 4),
        surface([g.unaligned.f_05 for g in geometry], 1),
        surface([g.scale for g in geometry], 2),
    ]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Read the command line and print the tables."""
    parser = argparse.ArgumentParser(description="Hold object programs against the truth.")
    parser.add_argument("programs", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--only", nargs="*", help="names of objects; default: all with a truth")
    parser.add_argument("--json", action="store_true", help="everything measured, as one object")
    args = parser.parse_args()
    files = [args.programs] if args.programs.is_file() else sorted(args.programs.glob("*.py"))
    names = [f.stem for f in files]
    if unknown := set(args.only or ()) - set(names):
        sys.exit(f"error: --only: no program {', '.join(sorted(unknown))}; there are {names}")
    files = [f for f in files if args.only is None or f.stem in args.only]
    known = [f for f in files if (args.truth / f"{f.stem}.json").exists()]
    if not known:
        sys.exit(f"error: {args.truth} holds no <name>.json for any program of {args.programs}")
    try:
        found = [score(file, args.truth) for file in known]
    except NeoWorldError as error:
        sys.exit(f"error: {error}")
    total = pooled([joints for joints, _ in found], "all")
    surfaces = [geometry for _, geometry in found if geometry is not None]
    if args.json:
        objects = {
            joints.name: {
                "joints": joints.model_dump(mode="json"),
                "geometry": None if geometry is None else geometry.model_dump(mode="json"),
            }
            for joints, geometry in found
        }
        print(json.dumps({"objects": objects, "all": total.model_dump(mode="json")}))
        return
    print(HEAD)
    print("|" + "---|" * HEAD.count(" | ") + "---|")
    for joints, geometry in found:
        print(row(joints, [] if geometry is None else [geometry]))
    print(row(total, surfaces))
    print(PAPER)
    print(f"\n{NOTE}\n")
    for pair in total.pairs:
        tell = [f"{pair.true} <- {pair.predicted}", f"{pair.true_type} as {pair.predicted_type}"]
        tell += [f"motion {pair.motion:.2f}", f"overlap {pair.agreement:.2f}"]
        print("  ".join(tell))
    for what, names in (("missed", total.missed), ("extra", total.extra)):
        print(f"{what}: {', '.join(names) or 'none'}")
    for file in sorted(set(files) - set(known)):
        print(f"left out, no truth: {file.stem}")


if __name__ == "__main__":
    main()

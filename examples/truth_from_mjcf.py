r"""Extract the joints and the surface of a published MJCF model as a program's ground truth.

    uv run python examples/truth_from_mjcf.py cabinet/model.xml --front=-y --name cabinet \
        --out truth

The script writes `<name>.json` and `<name>.npz`, which `neoworld bench run joints --truth` reads.
`--front` is the direction of the object's front in the model's frame, which the model itself does
not declare.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from neoworld_bench.measures import truth_of_mjcf

from neoworld_mjx.errors import NeoWorldError


def main() -> None:
    """Read the command line and write both files."""
    parser = argparse.ArgumentParser(description="Extract the ground truth of an MJCF model.")
    parser.add_argument("model", type=Path)
    parser.add_argument(
        "--front", choices=["+x", "-x", "+y", "-y"], required=True, help="write --front=-y"
    )
    parser.add_argument("--name", help="default: the file's name")
    parser.add_argument("--out", type=Path, required=True, help="folder")
    parser.add_argument("--source", default="", help="source of the model and its license")
    parser.add_argument(
        "--groups", type=int, nargs="+", default=[0, 1, 2], help="groups of visible geoms"
    )
    args = parser.parse_args()
    try:
        truth, points = truth_of_mjcf(args.model, front=args.front, groups=tuple(args.groups))
    except NeoWorldError as error:
        sys.exit(f"error: {error}")
    name = args.name or args.model.stem
    truth = truth.model_copy(update={"name": name, "source": args.source})
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / f"{name}.json").write_text(truth.model_dump_json(indent=1) + "\n", encoding="utf-8")
    np.savez_compressed(args.out / f"{name}.npz", allow_pickle=False, points=points)
    print(f"{name}: {len(truth.joints)} joints, {len(points)} samples")


if __name__ == "__main__":
    main()

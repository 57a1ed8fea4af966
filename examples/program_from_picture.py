"""Synthesize the program of one object from a picture of it: Step 2 alone, without a scene.

    uv run python examples/program_from_picture.py cabinet.png --size 0.4 0.6 0.8 --out runs/cabinet

The size is an estimate in metres: front to back, across, up. With a key in the environment a model
responds; with `--provider mailbox` each request becomes a folder in OUT/mailbox that awaits a
response.json (docs/models.md). The script writes program.py, program.json with all rounds,
spec.json, and pictures of the closed and the opened object; `neoworld export OUT/program.py --out
DIR` exports it.
"""

import argparse
import asyncio
import hashlib
import math
import sys
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from neoworld_mjx.config import load_config
from neoworld_mjx.errors import NeoWorldError, ProgramError
from neoworld_mjx.mllm import PROVIDERS, Picture, open_panel
from neoworld_mjx.parse.photo import load_photo
from neoworld_mjx.program.critique import Subject
from neoworld_mjx.program.synthesise import SynthesisResult, synthesise
from neoworld_mjx.program.views import draw
from neoworld_mjx.spec import Box2D, Box3D, Camera, PartState, TreeNode


def node_and_camera(args: argparse.Namespace, width: int, height: int) -> tuple[TreeNode, Camera]:
    """Return a parsed node of the object, and a camera in the picture's direction."""
    x, y, z = args.size
    distance = 4 * math.hypot(x, y, z)
    node = TreeNode(
        name=args.name,
        label=args.label or args.name.replace("_", " "),
        description=args.description,
        environment=False,
        box2d=Box2D(x0=0, y0=0, x1=width, y1=height),
        box3d=Box3D(
            position=(distance, 0, 0), size=(x, y, z), yaw=math.pi - math.radians(args.azimuth)
        ),
        articulation=tuple(moving(text) for text in args.moving),
    )
    camera = Camera(
        width=width,
        height_px=height,
        fovy=0.5,
        height=z / 2 + distance * math.tan(math.radians(args.elevation)),
        pitch=math.radians(args.elevation),
    )
    return node, camera


def moving(text: str) -> PartState:
    """Read "door:revolute" or "drawer:prismatic"."""
    part, _, kind = text.partition(":")
    return PartState.model_validate({"part": part, "type": kind or "revolute"})


def program(args: argparse.Namespace) -> SynthesisResult:
    """Synthesize the program and write the results."""
    config = load_config(args.config, {"provider": args.provider})
    photo = load_photo(args.picture, config.parse.max_side_px)
    height, width = photo.rgb.shape[:2]
    node, camera = node_and_camera(args, width, height)
    subject = Subject(node, Picture("crop", np.asarray(photo.rgb)), camera=camera)
    args.out.mkdir(parents=True, exist_ok=True)
    panel = open_panel(
        config.mllm,
        config.provider,
        photo=hashlib.sha256(args.picture.read_bytes()).hexdigest(),
        mailbox=args.out / "mailbox",
        record=args.out / "answers.tape.json",
    )
    with panel as models:
        result = asyncio.run(synthesise(subject, models, config.program))
    (args.out / "program.json").write_text(result.to_json(), encoding="utf-8")
    if result.spec is None:
        raise ProgramError(f"{args.name}: {result.reason}")
    (args.out / "program.py").write_text(result.text, encoding="utf-8")
    (args.out / "spec.json").write_text(result.spec.to_json(), encoding="utf-8")
    (args.out / "made.png").write_bytes(draw(result.spec, node, camera).data)
    (args.out / "opened.png").write_bytes(draw(result.spec, node, camera, opened=True).data)
    return result


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description="Synthesize the program of one object from one picture."
    )
    parser.add_argument("picture", type=Path)
    parser.add_argument(
        "--size",
        type=float,
        nargs=3,
        required=True,
        metavar=("X", "Y", "Z"),
        help="estimated size [m]",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder")
    parser.add_argument("--name", help="name of the object; default: the picture's name")
    parser.add_argument("--label", default="", help="kind of object, in a few words")
    parser.add_argument("--description", default="")
    parser.add_argument(
        "--moving", nargs="*", default=[], metavar="PART:TYPE", help="such as door:revolute"
    )
    parser.add_argument("--provider", choices=sorted(PROVIDERS), default="auto")
    parser.add_argument("--config", type=Path, help="YAML file of options, as for `neoworld`")
    parser.add_argument(
        "--azimuth", type=float, default=-35, help="direction of the camera [deg]; 0: front"
    )
    parser.add_argument("--elevation", type=float, default=28, help="elevation of the camera [deg]")
    args = parser.parse_args()
    args.name = args.name or args.picture.stem
    try:
        result = program(args)
    except NeoWorldError as error:
        sys.exit(f"error: {error}")
    except ValidationError as error:
        first = error.errors()[0]
        sys.exit(f"error: {first['loc'][0] if first['loc'] else 'input'}: {first['msg']}")
    for attempt in result.rounds:
        errors = sum(signal.severity == "error" for signal in attempt.built.signals)
        print(f"{attempt.stage:8} score {attempt.score:.2f}  errors {errors}")
    for step, reason in result.fallbacks:
        print(f"fallback: {step}: {reason}")
    print(f"kept: score {result.score:.2f}, in {args.out / 'program.py'}")


if __name__ == "__main__":
    main()

"""Have one object programmed from a single picture of it: Step 2 alone, without a scene.

    uv run python examples/program_from_picture.py cabinet.png --size 0.4 0.6 0.8 --out runs/cabinet

The size is an estimate in metres: front to back, across, up. With a key in the environment a model
answers; with `--provider mailbox` each request becomes a folder in OUT/mailbox, where response.json
is the answer (docs/models.md). OUT gets program.py, program.json with all rounds, spec.json,
and pictures of the object closed and opened; `neoworld build OUT/program.py` exports it.
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
from neoworld_mjx.program.synthesise import SynthesisResult, synthesise
from neoworld_mjx.program.views import draw
from neoworld_mjx.spec import Box2D, Box3D, Camera, PartState, TreeNode


def described(args: argparse.Namespace, width: int, height: int) -> tuple[TreeNode, Camera]:
    """Describe the object as a parse would, and a camera that sees it from that direction."""
    x, y, z = args.size
    away = 4 * math.hypot(x, y, z)
    node = TreeNode(
        name=args.name,
        label=args.label or args.name.replace("_", " "),
        description=args.description,
        environment=False,
        box2d=Box2D(x0=0, y0=0, x1=width, y1=height),
        box3d=Box3D(
            position=(away, 0, 0), size=(x, y, z), yaw=math.pi - math.radians(args.azimuth)
        ),
        articulation=tuple(moving(text) for text in args.moving),
    )
    camera = Camera(
        width=width,
        height_px=height,
        fovy=0.5,
        height=z / 2 + away * math.tan(math.radians(args.elevation)),
        pitch=math.radians(args.elevation),
    )
    return node, camera


def moving(text: str) -> PartState:
    """Read "door:revolute" or "drawer:prismatic"."""
    part, _, kind = text.partition(":")
    return PartState.model_validate({"part": part, "type": kind or "revolute"})


def program(args: argparse.Namespace) -> SynthesisResult:
    """Ask for the program and write what came of it."""
    config = load_config(args.config, {"provider": args.provider})
    photo = load_photo(args.picture, config.parse.max_side_px)
    height, width = photo.rgb.shape[:2]
    node, camera = described(args, width, height)
    crop = Picture.of("crop", np.asarray(photo.rgb)).data
    args.out.mkdir(parents=True, exist_ok=True)
    panel = open_panel(
        config.mllm,
        config.provider,
        photo=hashlib.sha256(args.picture.read_bytes()).hexdigest(),
        mailbox=args.out / "mailbox",
        record=args.out / "answers.tape.json",
    )
    with panel as models:
        made = asyncio.run(synthesise(node, crop, models, config.program, camera=camera))
    (args.out / "program.json").write_text(made.to_json(), encoding="utf-8")
    if made.spec is None:
        raise ProgramError(f"{args.name}: {made.reason}")
    (args.out / "program.py").write_text(made.text, encoding="utf-8")
    (args.out / "spec.json").write_text(made.spec.to_json(), encoding="utf-8")
    (args.out / "made.png").write_bytes(draw(made.spec, node, camera).data)
    (args.out / "opened.png").write_bytes(draw(made.spec, node, camera, opened=True).data)
    return made


def main() -> None:
    """Read the command line, and print how it went."""
    parser = argparse.ArgumentParser(description="Have one object programmed from one picture.")
    parser.add_argument("picture", type=Path)
    parser.add_argument(
        "--size", type=float, nargs=3, required=True, metavar=("X", "Y", "Z"), help="m, as judged"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder")
    parser.add_argument("--name", help="of the object; default: the picture's name")
    parser.add_argument("--label", default="", help="what it is, in a few words")
    parser.add_argument("--description", default="")
    parser.add_argument(
        "--moving", nargs="*", default=[], metavar="PART:TYPE", help="such as door:revolute"
    )
    parser.add_argument("--provider", choices=sorted(PROVIDERS), default="auto")
    parser.add_argument("--config", type=Path, help="YAML of options, as `neoworld` takes it")
    parser.add_argument(
        "--azimuth", type=float, default=-35, help="deg; from where the picture is taken, 0: front"
    )
    parser.add_argument("--elevation", type=float, default=28, help="deg above the horizontal")
    args = parser.parse_args()
    args.name = args.name or args.picture.stem
    try:
        made = program(args)
    except NeoWorldError as error:
        sys.exit(f"error: {error}")
    except ValidationError as error:
        wrong = error.errors()[0]
        sys.exit(f"error: {wrong['loc'][0] if wrong['loc'] else 'input'}: {wrong['msg']}")
    for attempt in made.rounds:
        errors = sum(signal.severity == "error" for signal in attempt.built.signals)
        print(f"{attempt.stage:8} score {attempt.score:.2f}  errors {errors}")
    for what, why in made.fallbacks:
        print(f"without {what}: {why}")
    print(f"kept: score {made.score:.2f}, in {args.out / 'program.py'}")


if __name__ == "__main__":
    main()

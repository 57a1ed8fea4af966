"""Render three objects, each programmed in both languages, and compare their joints.

    uv run python examples/compare_languages.py docs/pictures/languages.jpg

The cabinet is the one of both guides; cup and microwave are on the tapes of the bundled examples,
written by hand in both languages. Blender must be installed.
"""

import re
import statistics
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from neoworld_mjx.checks.object_tests import run_object_tests
from neoworld_mjx.config import Language, ProgramOptions
from neoworld_mjx.mllm.provider import bundled_tapes
from neoworld_mjx.mllm.replay import Tape
from neoworld_mjx.program import build
from neoworld_mjx.program.ask import ProgramResponse, instructions, join_texts
from neoworld_mjx.program.views import open_state
from neoworld_mjx.render import render_object
from neoworld_mjx.spec import ObjectSpec, bounds, inertial

LANGUAGES: tuple[Language, ...] = ("sdk", "blender")
WIDTH, HEIGHT, REPEATS = 360, 300, 3


def from_guide(language: Language) -> str:
    """Return the guide's last block, the cabinet."""
    return re.findall(r"```python\n(.*?)```", instructions("program", language), re.DOTALL)[-1]


def from_tape(photo: str, name: str, language: Language) -> str:
    """Return the programs of an object on a bundled tape, joined."""
    tape = Tape.load(bundled_tapes() / f"{photo}.tape.json")
    texts: dict[str, str] = {}
    for stage in ("geometry", "articulation", "export", "program"):
        answers = [entry for entry in tape.answers.values() if entry.name == f"{stage}:{name}"]
        for entry in answers:
            if ("Blender" in entry.model) == (language == "blender"):
                texts[stage] = ProgramResponse.model_validate_json(entry.text).program
    if "geometry" in texts:
        texts.pop("program", None)
    return join_texts(texts)


def joint_rows(sdk: ObjectSpec, blender: ObjectSpec) -> Iterator[str]:
    """Yield a table row of the differences between the objects for each joint of the first."""
    others = {joint.name: joint for joint in blender.joints}
    for joint in sdk.joints:
        other = others.get(joint.name)
        if other is None or other.type != joint.type:
            yield f"| {sdk.name} | {joint.name} | {joint.type} | not there | | |"
            continue
        axis = np.array(joint.axis)
        angle = np.degrees(np.arccos(np.clip(axis @ other.axis, -1, 1)))
        offset = np.array(other.pos) - joint.pos
        pivot = np.linalg.norm(offset - axis * (axis @ offset)) * 1000
        shown = "-" if joint.type == "prismatic" else f"{pivot:.1f}"
        limits = f"{joint.lower:g} to {joint.upper:g} and {other.lower:g} to {other.upper:g}"
        limits = "-" if joint.type == "continuous" else limits
        yield f"| {sdk.name} | {joint.name} | {joint.type} | {angle:.1f} | {shown} | {limits} |"


def main(out: Path) -> None:
    """Build, check, time, compare and render the objects."""
    objects = {
        "cabinet": from_guide,
        "cup": partial(from_tape, "coffee", "cup"),
        "microwave": partial(from_tape, "microwave", "microwave"),
    }
    rows, joints, tiles = [], [], []
    for name, text_of in objects.items():
        specs, cells, pictures = [], [name], []
        for language in LANGUAGES:
            text, seconds = text_of(language), []
            options = ProgramOptions(language=language)
            built = build(text, options)
            for _ in range(REPEATS):
                start = time.monotonic()
                built = build(text, options)
                seconds.append(time.monotonic() - start)
            spec = built.spec
            assert spec is not None, built.signals
            low, high = bounds(spec)
            edges = " x ".join(f"{v:.3f}" for v in high - low)
            mass = sum(inertial(spec, part).mass for part in spec.parts)
            pieces = sum(len(geom.shape.pieces()) for part in spec.parts for geom in part.geoms)
            verdict = "valid" if built.ok and run_object_tests(spec).verdict.passed else "not valid"
            median = statistics.median(seconds)
            cells.append(f"{edges}, {mass:.3g} kg, {pieces} pieces, {median:.2f} s, {verdict}")
            specs.append(spec)
            states = ({}, open_state(spec) or {})
            drawn = [render_object(spec, s, width=WIDTH, height=HEIGHT).color for s in states]
            pictures.append(np.hstack(drawn))
        rows.append(f"| {' | '.join(cells)} |")
        joints += joint_rows(*specs)
        tiles.append(np.hstack(pictures))
    Image.fromarray(np.vstack(tiles)).save(out, quality=86)
    lines = ["| object | SDK | Blender |", "|---|---|---|", *rows, ""]
    lines += ["| object | joint | type | axis, deg | pivot, mm | range, SDK and Blender |"]
    sys.stdout.write("\n".join([*lines, "|---|---|---|---|---|---|", *joints, ""]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

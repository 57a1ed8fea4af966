"""Render the gallery of the README: photograph, refined scene, and the scene with open joints.

for name in coffee drawers microwave; do uv run neoworld reconstruct $name --out $name; done
uv run python examples/draw_gallery.py coffee drawers microwave docs/pictures/examples.jpg
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from neoworld_mjx.program.views import opened_state
from neoworld_mjx.render import render_scene
from neoworld_mjx.spec import SceneSpec, read_scene

HEIGHT, GAP = 300, 8


def opened(scene: SceneSpec) -> SceneSpec:
    """Return a scene with all joints open."""
    objects = tuple(
        each.model_copy(update={"joint_state": {**each.joint_state, **opened_state(each.spec)}})
        for each in scene.objects
    )
    return scene.model_copy(update={"objects": objects})


def fitted(picture: Image.Image) -> Image.Image:
    """Return a picture scaled to the height of a row."""
    return picture.resize((round(picture.width * HEIGHT / picture.height), HEIGHT), Image.LANCZOS)


def row(run: Path) -> list[Image.Image]:
    """Return the pictures of a run."""
    scene = read_scene(run)
    moves = any(opened_state(each.spec) for each in scene.objects)
    scenes = (scene, opened(scene)) if moves else (scene,)
    views = [render_scene(each, width=640).color for each in scenes]
    with Image.open(run / "photo.png") as photo:
        return [fitted(photo.convert("RGB")), *(fitted(Image.fromarray(v)) for v in views)]


def main(*arguments: str) -> None:
    """Render one row for each run folder."""
    *runs, out = map(Path, arguments)
    rows = [row(run) for run in runs]
    width = max(sum(p.width for p in each) + GAP * (len(each) - 1) for each in rows)
    height = len(rows) * HEIGHT + GAP * (len(rows) - 1)
    canvas = Image.fromarray(np.full((height, width, 3), 255, np.uint8))
    for k, pictures in enumerate(rows):
        x = (width - sum(p.width for p in pictures) - GAP * (len(pictures) - 1)) // 2
        for picture in pictures:
            canvas.paste(picture, (x, k * (HEIGHT + GAP)))
            x += picture.width + GAP
    canvas.save(out, quality=85)


if __name__ == "__main__":
    main(*sys.argv[1:])

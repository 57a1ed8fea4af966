"""Draw the pictures of README and docs from runs of the bundled examples.

    for name in coffee drawers microwave; do
        uv run neoworld reconstruct $name --out runs/$name
    done
    uv run python examples/draw_gallery.py runs docs/pictures

writes examples.jpg (photograph, refined scene, the same with joints open), story.webp (photograph,
outlines of the reconstruction, refined scene, and the video policy.webp of `neoworld play`) and
report.jpg, a part of the report in a browser, which needs chromium (`apt-get install chromium`).
"""

import io
import shutil
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageChops, ImageOps, ImageSequence

from neoworld_mjx.pipeline.bundled_examples import bundled_examples
from neoworld_mjx.program.views import open_state
from neoworld_mjx.render import render_scene
from neoworld_mjx.spec import SceneSpec, read_scene

HEIGHT, GAP = 300, 8
STILL_MS, FRAME_MS = 1400, 200
"""Durations of the still pictures and of the frames of the video in story.webp [ms]."""
CHANGED = 40
"""Least difference of a pixel that moved, of 255."""
REPORT = (820, 1400)
"""Size of the shown part of the report [px]."""


def opened(scene: SceneSpec) -> SceneSpec:
    """Return a scene with all joints open."""
    objects = tuple(
        each.model_copy(update={"joint_state": {**each.joint_state, **open_state(each.spec)}})
        for each in scene.objects
    )
    return scene.model_copy(update={"objects": objects})


def picture(file: Path) -> Image.Image:
    """Return the picture of a file."""
    with Image.open(file) as read:
        return read.convert("RGB")


def rendered(scene: SceneSpec) -> Image.Image:
    """Return a picture of a scene through the camera of its photograph."""
    return Image.fromarray(render_scene(scene, width=640).color)


def row(run: Path) -> list[Image.Image]:
    """Return the photograph of a run, its scene, and the same with open joints."""
    scene = read_scene(run)
    moves = any(open_state(each.spec) for each in scene.objects)
    scenes = (scene, opened(scene)) if moves else (scene,)
    return [picture(run / "photo.png"), *map(rendered, scenes)]


def first_look(run: Path) -> list[Image.Image]:
    """Return the photograph of a run, the outlines of its objects over it, and its scene."""
    outlines = picture(run / "pictures" / "outlines.png")
    photo = picture(run / "photo.png")
    # The outlines of the composed and of the aligned scene are beside each other.
    aligned = outlines.crop((outlines.width - photo.width, 0, outlines.width, outlines.height))
    return [photo, aligned, rendered(read_scene(run))]


def differs(one: Image.Image, other: Image.Image) -> bool:
    """Return whether two frames of a video show different moments."""
    change = np.asarray(ImageChops.difference(one, other)).max(axis=-1)
    return float((change > CHANGED).mean()) > 0.004


def story(run: Path, video: Path, file: Path) -> None:
    """Write a moving picture of a run's first look, followed by a video without its still end."""
    with Image.open(video) as film:
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(film)]
    frames = frames[: 2 + max(k for k, each in enumerate(frames) if differs(each, frames[-1]))]
    stills = [ImageOps.fit(each, frames[0].size) for each in first_look(run)]
    durations = [STILL_MS] * len(stills) + [FRAME_MS] * (len(frames) - 1) + [STILL_MS]
    first, *others = stills + frames
    first.save(file, append_images=others, duration=durations, save_all=True, loop=0, quality=60)


def sheet(rows: list[list[Image.Image]]) -> Image.Image:
    """Return rows of pictures of one height, each row in the middle."""
    rows = [[p.resize((round(p.width * HEIGHT / p.height), HEIGHT)) for p in row] for row in rows]
    widths = [sum(p.width for p in row) + GAP * (len(row) - 1) for row in rows]
    size = (max(widths), len(rows) * HEIGHT + GAP * (len(rows) - 1))
    canvas = Image.fromarray(np.full((size[1], size[0], 3), 255, np.uint8))
    for k, (pictures, width) in enumerate(zip(rows, widths, strict=True)):
        x = (size[0] - width) // 2
        for each in pictures:
            canvas.paste(each, (x, k * (HEIGHT + GAP)))
            x += each.width + GAP
    return canvas


def report(file: Path) -> Image.Image:
    """Return the objects of a report and its scene in three dimensions, as a browser shows them."""
    from playwright.sync_api import sync_playwright

    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        page = browser.new_page(viewport={"width": REPORT[0], "height": REPORT[1]})
        page.goto(file.resolve().as_uri())
        page.wait_for_selector("canvas")
        heading = page.get_by_role("heading", name="Objects", exact=True)
        heading.evaluate("heading => window.scrollTo(0, heading.getBoundingClientRect().top - 24)")
        page.wait_for_timeout(2000)
        data = page.screenshot()
        browser.close()
    with Image.open(io.BytesIO(data)) as read:
        return read.convert("RGB")


def main(runs: Path, out: Path) -> None:
    """Write the pictures."""
    folders = [runs / name for name in bundled_examples()]
    sheet([row(folder) for folder in folders]).save(out / "examples.jpg", quality=85)
    story(runs / "drawers", out / "policy.webp", out / "story.webp")
    report(runs / "coffee" / "report.html").save(out / "report.jpg", quality=85)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))

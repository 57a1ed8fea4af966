"""Draw the pictures in docs of the browser pages, from a run of `coffee`.

    uv run neoworld reconstruct coffee --out out
    uv run --extra dev --extra viewer python -m examples.draw_coffee out docs/pictures

writes view-blend.jpg, view-colliders.jpg and view-object.jpg of `neoworld view`, and annotate.jpg
of `neoworld annotate`. It needs chromium (`apt-get install chromium`), and the repository, whose
tests drive the same pages.
"""

import sys
from pathlib import Path
from typing import NoReturn

from PIL import Image

from neoworld_mjx.config import Config
from neoworld_mjx.parse.photo import load_photo
from neoworld_mjx.view.annotate_page import Annotator
from neoworld_mjx.view.scene_viewer import SceneViewer
from neoworld_mjx.view.server import address, close_server, open_server
from neoworld_mjx.view.target import open_target
from tests.support.annotations import coffee
from tests.support.browser import Page, opened


def save(page: Page, file: Path, width: int = 900) -> None:
    """Save a page's picture once it no longer changes."""
    picture = Image.fromarray(page.settled())
    size = (width, round(picture.height * width / picture.width))
    picture.resize(size, Image.Resampling.LANCZOS).save(file, quality=85)


def draw_view(run: Path, out: Path) -> None:
    """Draw the pages of `neoworld view`."""
    server = open_server("coffee", port=0)
    try:
        SceneViewer(server, open_target(run, Config()))
        with opened(address(server)) as page:
            page.click("Home view")
            page.fill("Photo", 0.5)
            save(page, out / "view-blend.jpg")
            page.fill("Photo", 0)
            page.check("Colliders")
            save(page, out / "view-colliders.jpg")
            page.check("Colliders")
            page.choose("Object", "cup")
            page.check("Drag")
            save(page, out / "view-object.jpg")
    finally:
        close_server(server)


def draw_annotate(run: Path, out: Path) -> None:
    """Draw the page of `neoworld annotate` with two objects drawn."""
    server = open_server("annotate coffee.png", port=0)
    try:

        def refuse(annotation: object, simulate: bool) -> NoReturn:
            raise NotImplementedError("this page saves nothing")

        Annotator(server, load_photo(run / "photo.png"), out, coffee(), refuse)
        with opened(address(server)) as page:
            page.tab("Objects")
            page.choose("Object", "cup")
            save(page, out / "annotate.jpg", width=1200)
    finally:
        close_server(server)


if __name__ == "__main__":
    for draw in (draw_view, draw_annotate):
        draw(Path(sys.argv[1]), Path(sys.argv[2]))

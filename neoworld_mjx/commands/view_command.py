"""The commands `view` and `annotate`: pages in the browser."""

import logging
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from ..errors import RunError
from .base_command import CommandResult, ConfiguredCommand

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PageCommand(ConfiguredCommand):
    """Options of the commands that serve a page."""

    ends_by_interrupt: ClassVar[bool] = True

    host: str = "127.0.0.1"
    """Address to listen on. By default, only this machine can open the page. Users of the page can
    change files."""
    port: int | None = None
    """Port to listen on. Default: 8080, or any free port if 8080 is in use."""

    def serve_until_interrupted(self, address: str) -> CommandResult:
        """Log the page's address, and wait for Ctrl-C."""
        _log.info("open %s in a browser; Ctrl-C ends it", address)
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            _log.info("closed")
        return {"page": address}


@dataclass(frozen=True, kw_only=True)
class ViewCommand(PageCommand):
    """Show a scene or an object in the browser, and change it there."""

    target: Positional[Path]
    """A run folder, a scene.json, an object's folder, a program (.py), a URDF or an MJCF file."""

    def run(self) -> CommandResult:
        """Serve the page."""
        from ..pipeline import rebuild, search_again
        from ..view.pages.local_server import address, close_server, open_server
        from ..view.pages.scene_viewer import SceneViewer
        from ..view.pages.view_target import open_target

        config = self.load_config()
        target = open_target(self.target, config)  # Report a wrong path before a port is opened.
        server = open_server(f"neoworld: {target.title}", host=self.host, port=self.port)
        try:
            SceneViewer(
                *(server, self.target, target, config), rebuild=rebuild, search_again=search_again
            )
            return self.serve_until_interrupted(address(server))
        finally:
            close_server(server)


@dataclass(frozen=True, kw_only=True)
class AnnotateCommand(PageCommand):
    """Annotate a photograph by hand, without a model: boxes, labels, camera and templates."""

    photo: Positional[Path]
    """The photograph."""
    out: Path
    """Run folder: new, empty, or a run of this photograph to correct."""
    start: Annotated[Literal["parse"] | None, arg(name="from")] = None
    """Start from the parsed or annotated run in --out, instead of an empty page."""

    def run(self) -> CommandResult:
        """Serve the page."""
        from ..annotation.annotation import Annotation
        from ..pipeline.annotated import read_annotation, write_annotated
        from ..run_folder import Result
        from ..view.pages.annotate_page import Annotator, empty_annotation
        from ..view.pages.local_server import address, close_server, open_server

        config = self.load_config()
        annotation = empty_annotation(self.photo, config)
        if self.start is not None:
            empty, annotation = annotation.camera, read_annotation(self.out)
            run_size, photo_size = (
                f"{camera.width} x {camera.height_px} pixels"
                for camera in (annotation.camera, empty)
            )
            if run_size != photo_size:
                raise RunError(
                    f"{self.out} is a run of another photograph: that one has {run_size}, "
                    f"{self.photo} has {photo_size}"
                )
        elif self.out.exists() and (not self.out.is_dir() or any(self.out.iterdir())):
            raise RunError(
                f"{self.out} is not empty: correct its run with --from parse, or name "
                "another folder"
            )

        def write(annotation: Annotation, simulate: bool) -> Result:
            return write_annotated(self.photo, self.out, annotation, config, simulate=simulate)

        server = open_server(f"annotate {self.photo.name}", host=self.host, port=self.port)
        try:
            Annotator(server, self.photo, self.out, annotation, config, write)
            return self.serve_until_interrupted(address(server))
        finally:
            close_server(server)

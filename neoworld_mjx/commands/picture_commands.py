"""Commands `preview`, `render`, `view` and `annotate`: images, and pages in the browser."""

import logging
import math
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from tyro.conf import Positional, UseAppendAction, arg

from ..errors import RunError, SpecError
from .base_command import (
    EVIDENCE,
    Command,
    CommandResult,
    ConfiguredCommand,
    EvidenceFlags,
    check_photo,
)

if TYPE_CHECKING:
    from ..render import View
    from ..spec import Camera, SceneSpec

_log = logging.getLogger(__name__)
LARGEST_PX = 8192
"""Maximum side of a request's photograph, which is not resized again [px]."""
AZIMUTH_DEG, ELEVATION_DEG = 215.0, 28.0
"""Default direction of the camera, slightly to the side of the photograph's camera."""


@dataclass(frozen=True, kw_only=True)
class PreviewCommand(Command):
    """Draw a response to the request `parse` on the photograph, and check it, before it is given.

    For a request of a mailbox, write the response as draft.json into the request's folder, from
    which the photograph and the scene that a correction changes are read; response.json would
    submit it. A camera that is known from evidence is not used; the tool of `neoworld mcp` uses it.
    """

    response: Positional[Path]
    """The response: a JSON file, or a folder with response.json."""
    photo: Path | None = None
    """The photograph in the size that the request shows. Default: the first picture next to the
    response."""
    out: Path | None = None
    """Output file, by default preview.png next to the response."""

    def run(self) -> CommandResult:
        """Write the picture, and return the numbers."""
        from ..io.files import read_text, write_output
        from ..mllm.requests import MAX_BODY_BYTES
        from ..parse.photo import load_photo
        from ..parse.preview import preview

        folder = self.response if self.response.is_dir() else self.response.parent
        file = folder / "response.json" if self.response.is_dir() else self.response
        photo = self.photo or next(iter(sorted(folder.glob("1-*.*g"))), None)
        if photo is None:
            raise SpecError(f"{folder} contains no picture of a request: name one with --photo")
        texts = []
        for path in (file, folder / "prompt.md"):
            try:
                texts.append(read_text(path, MAX_BODY_BYTES))
            except FileNotFoundError:
                if path == file:
                    raise SpecError(f"{file}: no such file; write the response first") from None
                texts.append("")
            except OSError as error:
                raise SpecError(f"cannot read {path}: {error}") from None
        shown = preview(load_photo(photo, LARGEST_PX), *texts)
        out = self.out or folder / "preview.png"
        write_output(out, shown.picture.data, SpecError)
        return {"picture": str(out), "objects": shown.objects, "issues": shown.issues}

    def lines(self, result: CommandResult) -> list[str]:
        """Return one line for each object and each issue."""
        from ..parse.preview import number_lines

        return [*number_lines(result["objects"], result["issues"]), f"picture: {result['picture']}"]


@dataclass(frozen=True, kw_only=True)
class RenderCommand(ConfiguredCommand):
    """Render a scene or an object from the scene's or another camera."""

    target: Positional[Path]
    """A run folder, scene.json, object's folder, program (.py), or URDF, MJCF or glTF file."""
    out: Path | None = None
    """Output file, by default render.png next to the target."""
    width: int | None = None
    """Width of the image [px]."""
    azimuth: float | None = None
    """Azimuth of the camera [deg]; 180 is the direction of the photograph's camera."""
    elevation: float | None = None
    """Elevation of the camera [deg]."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Object that the camera frames; repeatable. Default: all objects except the environment."""
    fovy: float | None = None
    """Vertical field of view [deg]."""
    open: float | None = None
    """Position of every joint with limits, as a fraction of the joint's range, from 0 to 1."""

    def run(self) -> CommandResult:
        """Render the scene."""
        from ..io.files import write_output
        from ..render import render_scene, to_png
        from ..render.scene_images import with_open_joints
        from ..view.target import open_target

        config = self.load_config()
        options = config.render
        scene = open_target(self.target, config).after
        folder = self.target if self.target.is_dir() else self.target.parent
        out = self.out or folder / "render.png"
        if self.open is not None:
            if not 0 <= self.open <= 1:
                raise SpecError(f"--open: got {self.open:g}, valid is from 0 to 1")
            scene = with_open_joints(scene, self.open)
        width = self.width or options.width
        view = self._camera(scene, width)
        image = render_scene(scene, view, width=width, supersample=options.supersample)
        write_output(out, to_png(image), RunError)
        return {"picture": str(out), "size": [image.color.shape[1], image.color.shape[0]]}

    def _camera(self, scene: "SceneSpec", width: int) -> "Camera | View | None":
        """Return the camera that the flags define; None for the scene's camera."""
        from ..render import View
        from ..render.scene_images import subject_points

        azimuth, elevation, fovy = self._angles()
        directed = self.azimuth is not None or self.elevation is not None
        if not (self.object or directed):
            if self.fovy is None or scene.camera is None:
                return None
            return scene.camera.model_copy(update={"fovy": fovy})
        return View.framing(
            subject_points(scene, self.object),
            width=width,
            height=round(width * 2 / 3),
            azimuth=azimuth,
            elevation=elevation,
            fovy=fovy,
        )

    def _angles(self) -> tuple[float, float, float]:
        """Return azimuth, elevation and field of view [rad]."""
        from ..render.view import FOVY

        fovy = FOVY if self.fovy is None else math.radians(self.fovy)
        if not 0.02 < fovy < math.pi - 0.02:
            raise SpecError(f"--fovy: got {self.fovy:g}, valid is from 2 to 178 degrees")
        elevation = ELEVATION_DEG if self.elevation is None else self.elevation
        if not -90 <= elevation <= 90:
            raise SpecError(f"--elevation: got {elevation:g}, valid is from -90 to 90 degrees")
        azimuth = AZIMUTH_DEG if self.azimuth is None else self.azimuth
        return math.radians(azimuth), math.radians(elevation), fovy


@dataclass(frozen=True, kw_only=True)
class PageCommand(ConfiguredCommand):
    """Options of the commands that serve a page."""

    ends_by_interrupt: ClassVar[bool] = True

    host: str = "127.0.0.1"
    """Address to listen on. By default, only this machine can open the page."""
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
    """Show a scene or an object in the browser, with its joints and in free fall."""

    target: Positional[Path]
    """A run folder, scene.json, object's folder, program (.py), or URDF, MJCF or glTF file."""

    def run(self) -> CommandResult:
        """Serve the page."""
        from ..view.scene_viewer import SceneViewer
        from ..view.server import address, close_server, open_server
        from ..view.target import open_target

        # Report a wrong path before a port is opened.
        target = open_target(self.target, self.load_config())
        server = open_server(f"neoworld: {target.title}", host=self.host, port=self.port)
        try:
            SceneViewer(server, target)
            return self.serve_until_interrupted(address(server))
        finally:
            close_server(server)


@dataclass(frozen=True, kw_only=True)
class AnnotateCommand(EvidenceFlags, PageCommand):
    """Annotate a photograph by hand, without a model: boxes, labels, camera and templates."""

    inputs: ClassVar = ("config", *EVIDENCE)

    photo: Positional[Path]
    """The photograph."""
    out: Path
    """Run folder: new, empty, or a run of this photograph to correct."""
    start: Annotated[Literal["parse"] | None, arg(name="from")] = None
    """Start from the parsed or annotated run in --out, instead of an empty page."""

    def check_inputs(self) -> None:
        """Check the photograph, too."""
        super().check_inputs()
        check_photo(self.photo)

    def run(self) -> CommandResult:
        """Serve the page."""
        from ..pipeline.annotated import read_annotation, write_annotated
        from ..pipeline.given_evidence import known_photo
        from ..run_folder import Result
        from ..view.annotate_page import Annotator, empty_annotation
        from ..view.annotation import Annotation
        from ..view.server import address, close_server, open_server

        config = self.load_config()
        kept = None if self.start is None else self.out
        photo, known = known_photo(self.photo, config, self.stated(), kept)
        annotation = empty_annotation(photo, known.evidence.camera)
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
            return write_annotated(
                *(self.photo, self.out, annotation, config),
                simulate=simulate,
                evidence=known.evidence,
            )

        server = open_server(f"annotate {self.photo.name}", host=self.host, port=self.port)
        try:
            Annotator(server, photo, self.out, annotation, write)
            return self.serve_until_interrupted(address(server))
        finally:
            close_server(server)

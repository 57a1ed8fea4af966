"""Tools of an agent's server: what an agent may do with its run, as text and pictures.

The docstrings are the descriptions that an agent reads. A tool raises NeoWorldError with one line
that the agent can act on.
"""

import json
import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ..errors import RunError, SpecError, choices
from ..mllm import Picture
from ..mllm.mailbox_client import open_requests, read_request, respond
from ..mllm.requests import without_titles
from ..names import Format, Simulator
from ..quantities import count
from .agent_run import AgentRun

if TYPE_CHECKING:
    from ..spec import SceneTree

Content = list[str | Picture]
READ_S = 120.0
"""Maximum time until a run reads a response [s]; a run that continues starts to compute first."""
WIDTHS = range(16, 1569)
"""Valid widths of a rendered image [px]."""
AGAIN = "(as in the request {}; next_request(id, repeat=true) returns it again)"


class AgentTools:
    """The tools, for one agent's folder.

    Args:
        folder: the folder that contains the photographs, runs and exports.

    Raises:
        RunError: `folder` is no folder.
    """

    def __init__(self, folder: Path) -> None:
        self.agent_run = AgentRun(folder)
        self._shown: dict[str, str] = {}
        """Instructions and schemas that were returned, each with the id of the first request."""

    def start(
        self,
        photo: str,
        out: str = "",
        evidence: str = "",
        options: dict[str, Any] | None = None,
        fast: bool = False,
    ) -> Content:
        """Begin to reconstruct a photograph, or continue its run. Then call next_request().

        Args:
            photo: path of the photograph in the server's folder, or the name of a bundled example:
                coffee, drawers or microwave.
            out: run folder in the server's folder; default: NAME-scene.
            evidence: YAML file in the server's folder that names what is known of the camera, the
                depths and the masks, if the user has such files.
            options: nested options that differ from the defaults, such as {"seed": 1}.
            fast: ask for each response once, without critiques: fewer requests, more errors stay.
        """
        self.agent_run.start(photo, out, evidence, options, fast)
        self._shown.clear()
        self.agent_run.wait(5.0)
        if self.agent_run.error:
            raise RunError(self.agent_run.state())
        return self.status()

    def next_request(
        self, id: str | None = None, repeat: bool = False, wait_s: float = 45.0
    ) -> Content:
        """Return an open request: instructions, JSON schema, the request itself, and its pictures.

        Instructions and schemas that came with another request since start() are only named. All
        requests that wait for you are listed; answer them in any order. If no request is open, wait
        while the run computes.

        Args:
            id: the request; default: the oldest open one.
            repeat: return the instructions and the schema again.
            wait_s: maximum time to wait [s]; after that, call this again.
        """
        self.agent_run.wait(min(max(wait_s, 0.0), 600.0))
        mailbox = self.agent_run.mailbox
        if id is None and not open_requests(mailbox):
            return self.status()
        request = read_request(mailbox, id)
        parts = [f"# {request.id}", f"{request.title}. Open: {', '.join(open_requests(mailbox))}"]
        schema = json.dumps(without_titles(json.loads(request.schema)), separators=(",", ":"))
        for title, text in (("Instructions", request.instructions), ("JSON schema", schema)):
            first = self._shown.setdefault(text, request.id)
            # A result may be lost on its way, so an open request is returned with all that it had.
            known = first != request.id and not repeat
            parts += [f"## {title}", AGAIN.format(first) if known else text]
        labels = [f"{p.label}: {p.size[0]} x {p.size[1]} px" for p in request.pictures]
        parts += ["## Pictures, below in this order", "\n".join(labels), "## Request"]
        return ["\n\n".join([*parts, request.prompt]), *request.pictures]

    def zoom(
        self,
        box: tuple[float, float, float, float],
        picture: int = 1,
        id: str | None = None,
    ) -> Content:
        """Enlarge a region of a request's picture; rulers give pixels of the whole picture.

        Args:
            box: left, top, right and bottom of the region [px].
            picture: number of the picture in the request.
            id: the request; default: the oldest open one.
        """
        from ..parse.draw import draw_region

        request = read_request(self.agent_run.mailbox, id)
        if not 1 <= picture <= len(request.pictures):
            valid = range(1, len(request.pictures) + 1)
            raise SpecError(f"picture: {choices(str(picture), valid)}")
        if not all(math.isfinite(value) for value in box):
            raise SpecError("box: all four numbers must be finite")
        region = draw_region(request.pictures[picture - 1], box)
        whole = min(abs(box[2] - box[0]), request.pictures[picture - 1].size[0])
        hint = "" if region.size[0] > 1.5 * whole else "; name a smaller region to enlarge it more"
        return [f"{request.id}, picture {picture}{hint}", region]

    def preview(self, response: dict[str, Any], id: str | None = None) -> Content:
        """Draw the 3D boxes of a response to a request for a scene, and check its numbers.

        2D boxes are thick, 3D boxes are thin, and a line leads from each base to the object's
        front. "3D box" is the box of the projected outline [px].

        Args:
            response: the response, as for submit().
            id: the request; default: the oldest open one.
        """
        from ..parse.preview import number_lines, preview

        request = read_request(self.agent_run.mailbox, id)
        if "objects" not in json.loads(request.schema).get("properties", {}):
            raise SpecError(f"{request.id} asks for no scene; build() tries programs")
        photo, known = self.agent_run.photo()
        shown = preview(photo, json.dumps(response), request.prompt, known)
        return ["\n".join(number_lines(shown.objects, shown.issues)), shown.picture]

    def submit(self, id: str, response: dict[str, Any]) -> Content:
        """Answer a request. A response that does not fit is rejected with its mistakes.

        Args:
            id: the request, such as "0001-parse".
            response: one JSON object that fits the request's schema.
        """
        text = json.dumps(response, ensure_ascii=False)
        reason = respond(self.agent_run.mailbox, id, text, timeout_s=READ_S)
        if reason:
            raise SpecError(f"rejected: {reason}")
        self.agent_run.wait(2.0)
        return [f"accepted\n{self.agent_run.state()}"]

    def build(self, program: str, object: str) -> Content:
        """Run an object program in the sandbox, check and draw it; nothing is submitted.

        The picture "compared" shows the crop of the photograph and, beside it, the object in the
        same frame and size; "opened" shows the object with open joints, if parts move.

        Args:
            program: text of the program.
            object: name of the object in the parsed scene.
        """
        from ..parse.crops import crops
        from ..program.building import build
        from ..program.stages import compare_to_node
        from ..program.views import compare, draw, why_apart
        from ..spec import bounds, inertial

        config, tree = self.agent_run.config(), _tree(self.agent_run.current())
        names = [node.name for node in tree.nodes]
        if object not in names:
            raise SpecError(f"object: {choices(object, names)}")
        built, node = build(program, config.program), tree.node(object)
        rows = [f"printed: {built.printed}"] if built.printed else []
        if (spec := built.spec) is None:
            return ["\n".join(["does not build", *rows, *(s.phrase() for s in built.signals)])]
        low, high = bounds(spec)
        masses = ", ".join(f"{part.name} {inertial(spec, part).mass:.3g} kg" for part in spec.parts)
        rows += [f"size: {' x '.join(f'{v:.3f}' for v in (high - low).tolist())} m; {masses}"]
        rows += [
            f"joint {j.name}: {j.type}, {j.child} on {j.parent}, {j.lower:.3g} to {j.upper:.3g}"
            for j in spec.joints
        ]
        rows += [s.phrase() for s in (*built.signals, *compare_to_node(spec, node))]
        crop = crops(self.agent_run.photo()[0], tree)[object]
        pictures = compare(crop.picture, spec, node, tree.camera, crop.window)
        if any(joint.type != "fixed" for joint in spec.joints):
            pictures.append(draw(spec, node, tree.camera, opened=True))
        labels = ", ".join(picture.label for picture in pictures)
        if apart := why_apart(spec, node, tree.camera, crop.window):
            labels += f" (not side by side: {apart})"
        return ["\n".join(["builds" if built.ok else "fails", *rows, labels]), *pictures]

    def status(self) -> Content:
        """Return the state of the run: open requests, progress, or the verdict with reasons."""
        from .result_lines import DETAILS, run_lines

        state, result = self.agent_run.state(), self.agent_run.result
        rows = [] if result is None else run_lines(result.summary())[1:]
        rows = [row.removesuffix(f"; {DETAILS}") for row in rows]
        return ["\n".join([state, *rows])]

    def render(
        self,
        view: Literal["photo", "around"] = "photo",
        azimuth_deg: float = 215.0,
        elevation_deg: float = 28.0,
        objects: tuple[str, ...] = (),
        width: int = 900,
    ) -> Content:
        """Render the scene of the run, composed or refined.

        Args:
            view: "photo" is the photograph's camera, with the photograph beside it; "around" frames
                the objects from azimuth and elevation, where 180 is the photograph's direction.
            azimuth_deg: azimuth of the camera [deg].
            elevation_deg: elevation of the camera [deg].
            objects: objects that the view frames; default: all.
            width: width of the image [px].
        """
        from .picture_commands import RenderCommand

        out = self.agent_run.with_scene("compose/scene.json", "scene.json")
        if width not in WIDTHS:
            raise SpecError(f"width: got {width}, valid is from {WIDTHS[0]} to {WIDTHS[-1]}")
        direction = {"azimuth": azimuth_deg, "elevation": elevation_deg, "object": objects}
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "render.png"
            chosen: dict[str, Any] = direction if view == "around" else {}
            RenderCommand(target=out, out=file, width=width, **chosen).run()
            pictures = [Picture("render", file.read_bytes())]
        if view == "photo":
            pictures.append(Picture("photo", (out / "photo.png").read_bytes()))
        return [", then ".join(picture.label for picture in pictures), *pictures]

    def check(self) -> Content:
        """Check the scene, and list each check with its value and threshold."""
        from .object_commands import CheckCommand

        command = CheckCommand(target=self.agent_run.with_scene("scene.json"))
        result = command.run()
        rows = [f"{'pass' if c['passed'] else 'fail'}: {c['phrase']}" for c in result["checks"]]
        return ["\n".join([*command.lines(result)[:-1], *rows])]

    def edit(
        self,
        object: str,
        move: tuple[float, float] = (0.0, 0.0),
        turn_deg: float = 0.0,
        joints: dict[str, float] | None = None,
        program: str | None = None,
        wait_s: float = 45.0,
    ) -> Content:
        """Change an object of a finished run, compute the later steps again, and return the result.

        Without changes, return the object's pose in the world and its joints.

        Args:
            object: name of the object.
            move: shift [m] along the ground, away from the camera and to the camera's left.
            turn_deg: turn about the vertical [deg], anticlockwise seen from above.
            joints: positions by joint [rad or m].
            program: another program; the object is scaled to its size in the photograph.
            wait_s: maximum time to wait for the result [s]; after that, call next_request().
        """
        from ..spec import read_scene
        from .agent_edits import apply_edit, fall_of_agreement, pose_in_words

        out = self.agent_run.current()
        if self.agent_run.result is None:
            raise RunError(f"the run has not finished: {self.agent_run.state()}")
        scene, earlier = read_scene(out), self.agent_run.result.metrics
        names = [item.name for item in scene.objects]
        if object not in names:
            raise SpecError(f"object: {choices(object, names)}")
        change = apply_edit(
            out, scene, object, move, turn_deg, joints or {}, program, self.agent_run.config()
        )
        if change is None:
            return [pose_in_words(scene, object)]
        done, step = change
        self.agent_run.repeat(step)
        self.agent_run.wait(min(max(wait_s, 0.0), 600.0))
        rows = [done, *self.status()]
        if self.agent_run.result is not None:
            later = self.agent_run.result.metrics
            if joints and (fall := fall_of_agreement(earlier, later, object)):
                rows += [f"box IoU of {object} {fall}: the photograph shows its joints elsewhere"]
            rows += [f"before: {pose_in_words(scene, object)}"]
            rows += [f"now: {pose_in_words(read_scene(out), object)}"]
        return ["\n".join(map(str, rows))]

    def export(
        self,
        formats: tuple[Format, ...] = (),
        simulator: Simulator | None = None,
        out: str = "",
        overwrite: bool = False,
    ) -> Content:
        """Export the scene; list the files, and what the formats cannot hold.

        Args:
            formats: default: all, or those that suit the simulator best.
            simulator: simulator for which the files are written.
            out: new folder in the server's folder; default: RUN-export.
            overwrite: write into a folder that is not empty.
        """
        from .object_commands import ExportCommand

        target = self.agent_run.with_scene("scene.json")
        folder = self.agent_run.path(out or f"{target.name}-export")
        if not overwrite and folder.is_dir() and any(folder.iterdir()):
            raise RunError(
                f"{folder} is not empty: name another folder as out, or call with overwrite=true"
            )
        command = ExportCommand(
            target=target, out=folder, format=formats, simulator=simulator, overwrite=overwrite
        )
        result = command.run()
        files = [str(file) for file in result["files"]]
        rows = [file for file in files if "meshes/" not in file]
        if meshes := len(files) - len(rows):
            rows.append(f"and {count(meshes, 'file')} of meshes")
        return ["\n".join([*command.lines(result)[:-1], *rows])]


TOOLS = tuple(name for name in vars(AgentTools) if not name.startswith("_"))
"""Names of the tools."""


def _tree(out: Path) -> "SceneTree":
    from ..io import read_model
    from ..spec import SceneTree

    if not (out / "tree.json").is_file():
        raise RunError("the photograph is not parsed yet: answer the request for the scene first")
    return read_model(out / "tree.json", SceneTree, SpecError, "a scene tree")

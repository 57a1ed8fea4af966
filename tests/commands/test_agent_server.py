"""An agent reconstructs a photograph through the server alone, with the SDK's own client.

The bundled responses of an example stand in for the agent.
"""

import asyncio
import json
import logging
import math
import os
import re
import shutil
import sys
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("mcp")
from mcp import Client, MCPError, StdioServerParameters

from neoworld_mjx.commands import mcp_command
from neoworld_mjx.commands.agent_edits import fall_of_agreement, placement_of
from neoworld_mjx.commands.agent_run import AgentRun, _Computation, _Session
from neoworld_mjx.commands.agent_tools import TOOLS
from neoworld_mjx.commands.mcp_command import MAX_PICTURES_BYTES, McpCommand, bounded, build_server
from neoworld_mjx.errors import ConfigError, RunError, SpecError
from neoworld_mjx.mllm import Picture, Tape, bundled_tapes
from neoworld_mjx.names import STEPS
from neoworld_mjx.program import views
from neoworld_mjx.render import render
from neoworld_mjx.spec import SceneObject, SceneSpec, world_poses
from tests.conftest import QUICK
from tests.support import scenes

OPTIONS = {**QUICK, "compose": {"looks": False, "align": {"enabled": False}}}
TAPE = bundled_tapes() / "coffee.tape.json"


class Agent:
    """A client that answers from a tape, and counts what it does."""

    def __init__(self, client: Client, folder: Path) -> None:
        self.client, self.folder = client, folder
        self.tape = Tape.load(TAPE)
        self.progress: list[str] = []
        self.instructions: dict[str, str] = {}

    async def call(self, name, **arguments):
        """Return the text of a result and its pictures; raise Refused for an error."""
        result = await self.client.call_tool(name, arguments, progress_callback=self._note)
        texts = [block.text for block in result.content if block.type == "text"]
        if result.is_error:
            raise Refused("\n".join(texts))
        return "\n".join(texts), [block for block in result.content if block.type == "image"]

    async def _note(self, progress, total, message):
        self.progress.append(message or "")

    def response(self, name):
        """The response on the tape to an open request."""
        ticket = next(self.folder.glob(f"*/mailbox/{name}/request.json"))
        return self.tape.answers[json.loads(ticket.read_text())["key"]].answer

    async def next(self):
        """Return the next open request and its text; None and the state at the end."""
        while True:
            text, _ = await self.call("next_request", wait_s=20)
            if text.startswith("# "):
                return text.split("\n")[0][2:], text
            if ": computes" not in text:
                return None, text


class Refused(Exception):
    """A tool returned an error."""


@asynccontextmanager
async def agent(folder):
    async with Client(build_server(folder)) as client:
        yield Agent(client, folder)


async def refused(work) -> str:
    with pytest.raises(Refused) as error:
        await work
    return str(error.value)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A scene that was built through the server: the folder, and the agent's observations."""
    folder = tmp_path_factory.mktemp("desk")
    seen: dict[str, str] = {}

    async def build():
        async with agent(folder) as coffee:
            seen["start"], _ = await coffee.call("start", photo="coffee", options=OPTIONS)
            while (request := await coffee.next())[0] is not None:
                name, text = request
                seen[name] = text
                response = coffee.response(name)
                if name == "0001-parse":
                    seen["zoom"], pictures = await coffee.call("zoom", box=[170, 0, 410, 310])
                    assert [picture.mime_type for picture in pictures] == ["image/png"]
                    seen["no zoom"] = await refused(
                        coffee.call("zoom", box=[0, 0, 9, 9], picture=2)
                    )
                    seen["preview"], pictures = await coffee.call("preview", response=response)
                    assert len(pictures) == 1
                    broken = {**response, "camera": {"pitch_deg": "x", "height": 1}}
                    seen["rejected"] = await refused(
                        coffee.call("submit", id=name, response=broken)
                    )
                    seen["early build"] = await refused(
                        coffee.call("build", program="", object="cup")
                    )
                    for tool in ("render", "check", "export"):
                        seen[f"early {tool}"] = await refused(coffee.call(tool))
                    seen["early edit"] = await refused(coffee.call("edit", object="cup"))
                if name.endswith("program-cup"):
                    program = response["program"]
                    seen["build"], pictures = await coffee.call(
                        "build", program=program, object="cup"
                    )
                    assert len(pictures) == 1  # the crop beside the object
                    seen["no build"] = await refused(
                        coffee.call("build", program=program, object="cop")
                    )
                    seen["wrong preview"] = await refused(
                        coffee.call("preview", response={}, id=name)
                    )
                seen["accepted"], _ = await coffee.call("submit", id=name, response=response)
            seen["end"] = request[1]
            seen["progress"] = "\n".join(coffee.progress)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mcp_command, "PROGRESS_S", 0.1)  # Shorter than the steps of this scene.
        # Nobody looks at the pictures, whose shadows take most of the time.
        patch.setattr(views, "render", partial(render, supersample=1, shadows=False))
        asyncio.run(build())
    return folder, seen


def place(text):
    """The x, y [m] and heading [deg] that `edit` returns."""
    found = re.match(r"\w+ on \w+: at (\S+) (\S+) \S+, yaw_deg (\S+), joints {}", text)
    assert found, text
    return tuple(map(float, found.groups()))


def copy_of(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "desk")
    return tmp_path / "desk"


def test_a_scene_is_built_through_the_server(built):
    folder, seen = built
    assert "coffee-scene: waits for you: 0001-parse" in seen["start"]
    assert "coffee-scene: finished: valid: all 7 checks pass" in seen["end"]
    data = json.loads((folder / "coffee-scene" / "run.json").read_text())
    assert data["status"] == "finished"
    assert data["fallbacks"] == []
    assert data["mllm"]["provider"] == "mailbox"
    assert (folder / "coffee-scene" / "scene.xml").is_file()


def test_a_request_has_all_that_an_agent_needs(built):
    _, seen = built
    text = seen["0001-parse"]
    for part in (
        "# Camera and world",
        '"pitch_deg"',
        "1-photo: 600 x 400 px",
        "Describe the scene",
    ):
        assert part in text
    assert '"title":' not in text
    programs = [text for name, text in seen.items() if re.match(r"\d{4}-program-", name)]
    assert len(programs) == 3
    # The requests of all objects are open together, although their pictures are drawn in turn.
    assert "Open: 0003-program-saucer, 0004-program-cup, 0005-program-spoon" in programs[0]
    assert sum("# Writing an object program" in text for text in programs) == 1
    assert sum("next_request(id, repeat=true)" in text for text in programs) == 2


def test_a_response_is_tried_before_it_is_given(built):
    _, seen = built
    assert "cup: box 172 17 409 308; outline" in seen["preview"]
    assert "asks for no scene; build() tries programs" in seen["wrong preview"]
    assert seen["build"].startswith("builds\nsize: ")
    assert seen["build"].endswith("compared")
    assert "did you mean 'cup'?" in seen["no build"]
    assert "the photograph is not parsed yet" in seen["early build"]
    assert "picture: got '2', valid are: 1" in seen["no zoom"]


def test_pictures_of_a_result_fit_into_what_a_client_accepts(tmp_path):
    """The client of the SDK refuses results above 1 MiB, in which bytes are written as base64."""
    noise = np.random.default_rng(0).integers(0, 256, (700, 900, 3), np.uint8)
    pictures = [Picture(f"photo {k}", noise) for k in range(3)]
    assert sum(len(picture.data) for picture in pictures) > 2**20
    sent = bounded(["text", *pictures], MAX_PICTURES_BYTES)
    assert sent[0] == "text"
    assert {media_type for media_type, _ in sent[1:]} == {"image/jpeg"}
    small = Picture("small", noise[:20, :20])
    assert bounded([small], MAX_PICTURES_BYTES) == [("image/png", small.data)]


def test_a_rejection_lists_every_mistake(built):
    _, seen = built
    assert "response.rejected" not in seen["rejected"]
    assert "camera.pitch_deg" in seen["rejected"]
    assert "camera.fovy_deg: Field required" in seen["rejected"]
    assert seen["accepted"].startswith("accepted\n")
    assert "the run has not finished: coffee-scene: waits for you" in seen["early edit"]
    for tool in ("render", "check", "export"):
        assert "no scene yet: coffee-scene: waits for you: 0001-parse" in seen[f"early {tool}"]


def test_long_work_reports_progress(built):
    _, seen = built
    steps = "|".join(STEPS)
    computing = re.compile(rf"({steps}) \d+ s · \d+ calls? · computing")
    assert any(computing.fullmatch(line) for line in seen["progress"].splitlines())


def test_a_finished_run_is_checked_rendered_edited_and_exported(built, tmp_path):
    folder = copy_of(built[0], tmp_path)

    async def use():
        async with agent(folder) as coffee:  # A restarted server: nobody calls start.
            assert "finished: valid" in (await coffee.next())[1]
            text, _ = await coffee.call("check")
            assert "pass: saucer and spoon: penetration" in text
            _, pictures = await coffee.call("render", width=200)
            assert len(pictures) == 2
            _, pictures = await coffee.call("render", view="around", objects=["cup"], width=200)
            assert len(pictures) == 1
            assert "cap" in await refused(coffee.call("render", view="around", objects=["cap"]))
            for width in (-5, 10**9):
                assert "from 16 to 1568" in await refused(coffee.call("render", width=width))
            long = {"formats": ["mjcf"], "out": "x" * 300}
            assert "is not a path" in await refused(coffee.call("export", **long))
            text, _ = await coffee.call("export", formats=["urdf"], out="robot/scene")
            assert "objects/cup/object.urdf" in text
            refusal = await refused(coffee.call("export", out="robot/scene"))
            assert "is not empty" in refusal and "overwrite=true" in refusal and "--" not in refusal
            text, _ = await coffee.call("export", out="robot/scene", overwrite=True)
            lines, listed = text.splitlines(), re.compile(r"[\w/.-]+\.\w+|and \d+ files? of meshes")
            named = sum(bool(listed.fullmatch(row)) for row in lines)
            meshes = int(re.search(r"and (\d+) files? of meshes", text)[1])
            assert re.match(rf"written: {named - 1 + meshes} files", text)
            assert "--json" not in (await coffee.call("status"))[0]

            async def on_saucer():
                """Place of the cup relative to the saucer, which may move with other evidence."""
                cup, saucer = [
                    place((await coffee.call("edit", object=name))[0]) for name in ("cup", "saucer")
                ]
                return cup[0] - saucer[0], cup[1] - saucer[1], cup[2]

            x, y, yaw = await on_saucer()
            for change, message in (
                ({"object": "cop"}, "did you mean 'cup'?"),
                ({"object": "cup", "joints": {"lid": 1}}, "joints: got 'lid', valid are: none"),
                ({"object": "cup", "program": "import os"}, "exactly one Object"),
                ({"object": "cup", "move": ["far", 1]}, "move.0"),
                ({"object": "cup", "move": [1e300, 1]}, "valid is up to 100 m"),
            ):
                assert message in await refused(coffee.call("edit", **change))
            cup = folder / "coffee-scene" / "objects" / "cup"
            program = re.sub('label="[^"]*"', 'label="changed"', (cup / "program.py").read_text())
            change = {"move": [0.0, 0.003], "turn_deg": 3, "program": program}
            done, _ = await coffee.call("edit", object="cup", wait_s=300, **change)
            assert done.startswith("cup: moved, turned, another program\n")
            while (request := await coffee.next())[0] is not None:
                await coffee.call("submit", id=request[0], response={"verdict": "sound"})
            assert "finished" in request[1]
            *xy, turned = await on_saucer()
            # Four positions with four decimals, two headings with two.
            assert xy == pytest.approx((x, y + 0.003), abs=3e-4)
            assert turned == pytest.approx(yaw + 3, abs=0.02)
            assert json.loads((cup / "spec.json").read_text())["label"] == "changed"
            # An edit returns its result.
            done, _ = await coffee.call("edit", object="cup", turn_deg=5, wait_s=300)
            before, now = (place(row.partition(": ")[2]) for row in done.splitlines()[-2:])
            assert "finished: valid" in done and now[2] - before[2] == pytest.approx(5, abs=0.1)

    asyncio.run(use())
    assert (folder / "robot" / "scene").is_dir()


def test_requests_that_are_not_open_yet_are_one_state(tmp_path):
    def progress(unanswered):
        facts = {"step": "program", "unanswered": unanswered}
        return logging.makeLogRecord({"levelno": logging.DEBUG, "facts": facts})

    run = AgentRun(tmp_path)
    (tmp_path / "p-scene").mkdir()
    run._latest = _Computation(_Session(photo="p.png", out="p-scene"))
    run._progress.emit(progress(2))
    assert run.state() == "p-scene: prepares requests for you: call next_request()"
    run._progress.emit(progress(0))
    assert run.state().startswith("p-scene: computes: program")


def test_an_edit_of_joints_says_why_the_agreement_falls():
    def measured(value):
        return {"box_iou": {"objects": {"cup": {"refined": value}}}}

    assert fall_of_agreement(measured(0.99), measured(0.951), "cup") == "0.99 -> 0.95"
    assert not fall_of_agreement(measured(0.99), measured(0.991), "cup")
    assert not fall_of_agreement({}, measured(0.99), "cup")


def test_every_tool_needs_a_run(tmp_path):
    arguments = {
        "zoom": {"box": [0, 0, 9, 9]},
        "preview": {"response": {}},
        "submit": {"id": "0001-parse", "response": {}},
        "build": {"program": "", "object": "cup"},
        "edit": {"object": "cup"},
        "start": {"photo": "none.jpg"},
    }

    async def use():
        async with agent(tmp_path) as nobody:
            listed = (await nobody.client.list_tools()).tools
            assert [tool.name for tool in listed] == list(TOOLS)
            for tool in listed:
                assert tool.description
                assert tool.input_schema["type"] == "object"
                assert "ctx" not in tool.input_schema["properties"]
                message = await refused(nobody.call(tool.name, **arguments.get(tool.name, {})))
                expected = "neither a file in" if tool.name == "start" else "no run: call start"
                assert expected in message, tool.name

    asyncio.run(use())


HOSTILE = {
    "a path above": ({"photo": "../photo.png"}, "outside the folder of this server"),
    "an absolute path": ({"photo": "/etc/passwd"}, "outside the folder of this server"),
    "a link out": ({"photo": "link.png"}, "outside the folder of this server"),
    "a long path": ({"photo": "p.png", "out": "x" * 300}, "is not a path"),
    "no path": ({"photo": "a\0b"}, "is not a path"),
    "a run outside": ({"photo": "p.png", "out": "../run"}, "outside the folder of this server"),
    "the folder itself": ({"photo": "p.png", "out": "."}, "name a new folder"),
    "a server": (
        {"photo": "p.png", "options": {"mllm": {"base_url": "http://x"}}},
        "mllm is fixed",
    ),
    "a provider": ({"photo": "p.png", "options": {"provider": "anthropic"}}, "provider is fixed"),
    "bounds of files": ({"photo": "p.png", "options": {"files": {}}}, "files is fixed"),
    "another sandbox": (
        {"photo": "p.png", "options": {"program": {"language": "blender"}}},
        "program.language is fixed",
    ),
    "code to run": (
        {"photo": "p.png", "options": {"refine": {"optimizer": "os:system"}}},
        r"names code to run \(os:system\)",
    ),
    "an unknown option": ({"photo": "p.png", "options": {"sed": 1}}, "unknown key sed"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_client_gets_one_line(name, tmp_path):
    arguments, expected = HOSTILE[name]
    folder = tmp_path / "desk"
    folder.mkdir()
    Image.new("RGB", (32, 32)).save(folder / "p.png")
    Image.new("RGB", (32, 32)).save(tmp_path / "photo.png")
    (folder / "link.png").symlink_to(tmp_path / "photo.png")

    async def use():
        async with agent(folder) as stranger:
            message = await refused(stranger.call("start", **arguments))
            assert re.search(expected, message)
            assert "\n" not in message

    asyncio.run(use())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["desk", "photo.png"]
    assert sorted(path.name for path in folder.iterdir()) == ["link.png", "p.png"]


def test_a_file_that_is_no_photograph_is_an_error_of_start(tmp_path):
    (tmp_path / "notes.png").write_text("buy milk")

    async def use():
        async with agent(tmp_path) as stranger:
            message = await refused(stranger.call("start", photo="notes.png"))
            assert "notes-scene: stopped: " in message
            assert "stopped" in (await stranger.call("status"))[0]

    asyncio.run(use())


def test_a_hostile_session_file_is_refused(tmp_path):
    session = {"photo": "coffee", "out": "x", "options": {"refine": {"optimizer": "os:system"}}}
    (tmp_path / ".neoworld-agent.json").write_text(json.dumps(session))

    async def use():
        async with agent(tmp_path) as stranger:
            assert "names code to run" in await refused(stranger.call("status"))
            uri = "neoworld://picture/..%2F..%2Fsecret"
            for bad in (uri, "neoworld://report"):
                with pytest.raises(MCPError):
                    await stranger.client.read_resource(bad)

    asyncio.run(use())


def test_a_known_camera_is_told_to_the_agent_and_used_in_previews(tmp_path):
    camera = {"width": 600, "height": 400, "fx": 900, "fy": 900, "cx": 300, "cy": 200}
    (tmp_path / "known.yaml").write_text(json.dumps({"camera": camera}))
    (tmp_path / "stolen.yaml").write_text(json.dumps({"camera": "../camera.json"}))
    (tmp_path / "depth.yaml").write_text(json.dumps({"depth": {"file": "/etc/passwd"}}))

    async def use():
        async with agent(tmp_path) as coffee:
            for file in ("stolen.yaml", "depth.yaml", "../known.yaml"):
                message = await refused(coffee.call("start", photo="coffee", evidence=file))
                assert "outside the folder of this server" in message
            await coffee.call("start", photo="coffee", evidence="known.yaml")
            text, _ = await coffee.call("next_request")
            assert "25.06" in text or "25.1" in text  # 2 atan(200 / 900)
            parse = next(e for e in coffee.tape.answers.values() if e.name == "parse").answer
            known, _ = await coffee.call("preview", response=parse)
            assert "cup: box 172 17 409 308; outline" in known
        return known

    known = asyncio.run(use())
    shutil.rmtree(tmp_path / "coffee-scene")
    (tmp_path / ".neoworld-agent.json").unlink()

    async def without():
        async with agent(tmp_path) as coffee:
            await coffee.call("start", photo="coffee", out="other")
            parse = next(e for e in coffee.tape.answers.values() if e.name == "parse").answer
            return (await coffee.call("preview", response=parse))[0]

    assert asyncio.run(without()) != known


def test_a_mailbox_that_leads_out_is_refused(tmp_path):
    folder, other = tmp_path / "desk", tmp_path / "other"
    (folder / "coffee-scene").mkdir(parents=True)
    (other / "0001-parse").mkdir(parents=True)
    (other / "0001-parse" / "waiting.md").write_text("")
    (folder / "coffee-scene" / "mailbox").symlink_to(other)

    async def use():
        async with agent(folder) as stranger:
            message = await refused(stranger.call("start", photo="coffee"))
            assert "outside the folder of this server" in message

    asyncio.run(use())
    assert (other / "0001-parse" / "waiting.md").exists()


def test_one_run_at_a_time_and_only_open_requests(tmp_path):
    async def use():
        async with agent(tmp_path) as coffee:
            await coffee.call("start", photo="coffee", options=OPTIONS)
            assert (
                "waits for you" in (await coffee.call("start", photo="coffee", options=OPTIONS))[0]
            )
            message = await refused(coffee.call("start", photo="drawers"))
            assert "the run in coffee-scene computes or waits for you" in message
            for name in ("0002-parse", "../0001-parse", ""):
                expected = "valid are: 0001-parse"
                for tool in ("submit", "preview"):
                    call = coffee.call(tool, id=name, response={})
                    assert expected in await refused(call)
                assert expected in await refused(coffee.call("next_request", id=name))
            whole, pictures = await coffee.call("next_request")
            again, _ = await coffee.call("next_request", id="0001-parse")
            assert len(pictures) == 1
            assert again == whole  # A client may have lost what it has not answered.

    asyncio.run(use())


def test_instructions_come_again_after_start(tmp_path):
    """A request of an earlier run, or one that an agent has forgotten, is no place to look."""
    mailbox = tmp_path / "coffee-scene" / "mailbox"

    async def use():
        async with agent(tmp_path) as coffee:
            await coffee.call("start", photo="coffee", options=OPTIONS)
            assert "You look at one photograph" in (await coffee.next())[1]
            (mailbox / "0007-earlier").mkdir()
            (mailbox / "0001-parse").rename(tmp_path / "gone")  # The run stops.
            assert "coffee-scene: stopped" in (await coffee.next())[1]
            await coffee.call("start", photo="coffee", options=OPTIONS)
            name, text = await coffee.next()
            assert name == "0008-parse"
            assert "You look at one photograph" in text and "as in the request" not in text

    asyncio.run(use())


def test_a_program_of_an_agent_is_confined(built, tmp_path):
    folder = copy_of(built[0], tmp_path)
    programs = {
        "open('/etc/passwd').read()": "open",
        "import subprocess": "subprocess",
        "while True: pass": "took over 1 s",
    }

    async def use():
        async with agent(folder) as coffee:
            await coffee.next()
            for program, word in programs.items():
                text, pictures = await coffee.call("build", program=program, object="cup")
                assert text.startswith("does not build")
                assert word in text
                assert not pictures

    asyncio.run(use())


def test_resources_hold_the_guide_the_skill_and_the_run(built, tmp_path):
    folder = copy_of(built[0], tmp_path)

    async def read(client, uri):
        return (await client.read_resource(uri)).contents[0]

    async def use():
        async with agent(folder) as coffee:
            await coffee.next()
            assert "next_request()" in (await read(coffee.client, "neoworld://skill")).text
            prompt = await coffee.client.get_prompt("reconstruct", {"photo": "desk.jpg"})
            assert "Reconstruct the photograph 'desk.jpg'" in prompt.messages[0].content.text
            assert "lathe(" in (await read(coffee.client, "neoworld://guide")).text
            assert "<html" in (await read(coffee.client, "neoworld://report")).text
            assert (await read(coffee.client, "neoworld://picture/parse")).blob
            with pytest.raises(MCPError, match=r"has no pictures/none\.png"):
                await read(coffee.client, "neoworld://picture/none")

    asyncio.run(use())


def test_a_run_that_is_cut_off_over_stdio_continues(tmp_path):
    """The first server is a process of its own, which ends while requests wait."""
    server = StdioServerParameters(
        command=sys.executable,
        args=["-m", "neoworld_mjx.cli", "mcp", "--folder", str(tmp_path)],
        env=dict(os.environ),
    )

    async def first():
        async with Client(server) as client:
            coffee = Agent(client, tmp_path)
            await coffee.call("start", photo="coffee", options=OPTIONS)
            for _ in range(2):
                name, _ = await coffee.next()
                await coffee.call("submit", id=name, response=coffee.response(name))
            name, _ = await coffee.next()
            return name

    async def second():
        async with agent(tmp_path) as coffee:
            return (await coffee.next())[1]

    name = asyncio.run(first())
    assert name == "0003-program-saucer"
    text = asyncio.run(second())
    assert text.startswith(f"# {name}\n")
    assert "Open: 0003-program-saucer, 0004-program-cup, 0005-program-spoon" in text
    assert len(list((tmp_path / "coffee-scene" / "mailbox").iterdir())) == 5


def test_http_is_served_on_this_machine_only(tmp_path, monkeypatch):
    from mcp.server.mcpserver import MCPServer
    from starlette.testclient import TestClient

    calls = []
    monkeypatch.setattr(MCPServer, "run", lambda self, *a, **k: calls.append((a, k)))
    McpCommand(folder=tmp_path, port=8123).run()
    assert calls == [(("streamable-http",), {"host": "127.0.0.1", "port": 8123})]
    with pytest.raises(ConfigError, match="--port: got 0"):
        McpCommand(folder=tmp_path, port=0).run()
    app = build_server(tmp_path).streamable_http_app(host="127.0.0.1")
    headers = {"accept": "application/json, text/event-stream"}
    with TestClient(app, base_url="http://evil.example") as client:
        assert client.post("/mcp", json={}, headers=headers).status_code == 421
    app = build_server(tmp_path).streamable_http_app(host="127.0.0.1")
    with TestClient(app, base_url="http://127.0.0.1:8123") as client:
        headers |= {"origin": "http://evil.example"}
        assert client.post("/mcp", json={}, headers=headers).status_code == 403


def test_a_folder_that_is_missing_is_one_error(tmp_path):
    with pytest.raises(RunError, match="is not a folder"):
        build_server(tmp_path / "none")


def test_without_the_extra_the_command_names_it(neoworld, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcp.server.mcpserver", None)
    done = neoworld("mcp", "--folder", tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "error: neoworld mcp needs its extra: uv sync --inexact --extra mcp\n"


def test_the_skill_is_printed_and_installed(neoworld, tmp_path):
    done = neoworld("skill")
    assert done.returncode == 0
    assert done.stdout.startswith("---\nname: neoworld\n")
    for tool in TOOLS:
        assert tool in done.stdout, f"the skill does not name {tool}"
    done = neoworld("skill", "--install", tmp_path / "skills")
    assert (tmp_path / "skills" / "neoworld" / "SKILL.md").read_text().startswith("---\n")
    (tmp_path / "file").write_text("")
    done = neoworld("skill", "--install", tmp_path / "file")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)


def test_an_edit_is_in_the_world_and_within_the_range_of_joints():
    spec = scenes.cabinet()
    joint = next(joint for joint in spec.joints if joint.type == "prismatic")
    slab = SceneObject(name="slab", spec=scenes.table(), xy=(1.0, 0.0), yaw=1.0)
    item = SceneObject(name="box", spec=spec, parent="slab", xy=(0.1, 0.2))

    def at(thing):
        return world_poses(SceneSpec(objects=(slab, thing)))["box"].pos

    scene = SceneSpec(objects=(slab, item))
    placement = placement_of(scene, "box", (0.3, -0.1), 90, {joint.name: joint.upper})
    assert placement is not None
    moved = item.model_copy(update={"xy": placement.xy})
    assert at(moved) - at(item) == pytest.approx([0.3, -0.1, 0.0])
    assert placement.yaw == pytest.approx(math.pi / 2)
    assert placement.joint_state == {joint.name: joint.upper}
    with pytest.raises(SpecError, match=f"joints: {joint.name}: got 9, valid is 0 to"):
        placement_of(scene, "box", (0, 0), 0, {joint.name: 9.0})
    assert placement_of(scene, "box", (0, 0), 0, {}) is None

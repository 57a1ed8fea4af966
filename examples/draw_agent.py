"""Draw the picture in docs of what an agent sees, with the bundled responses of `coffee`.

    uv run --extra mcp python -m examples.draw_agent docs/pictures

writes agent.jpg: the preview of the parse, the crop of the cup beside the built cup, and the
finished scene. It calls the tools as `neoworld mcp` does, and answers from the tape.
"""

import json
import sys
import tempfile
from pathlib import Path

from PIL import Image

from neoworld_mjx.commands.agent_tools import AgentTools, Content
from neoworld_mjx.mllm import Picture, Tape, bundled_tapes

HEIGHT = 400


def answer(folder: Path) -> dict[str, list[Picture]]:
    """Answer all requests from the tape; return the pictures of some tools by the tool's name."""
    tools, tape = AgentTools(folder), Tape.load(bundled_tapes() / "coffee.tape.json")
    shown: dict[str, list[Picture]] = {}
    tools.start("coffee")
    while True:
        first = str(tools.next_request()[0])
        if not first.startswith("# "):
            if "computes" in first:
                continue
            shown["render"] = pictures(tools.render())
            return shown
        name = first.split("\n", maxsplit=1)[0].removeprefix("# ")
        ticket = folder / "coffee-scene" / "mailbox" / name / "request.json"
        response = tape.answers[json.loads(ticket.read_text())["key"]].answer
        assert isinstance(response, dict)
        if name == "0001-parse":
            shown["preview"] = pictures(tools.preview(response))
        if name.endswith("program-cup"):
            shown["build"] = pictures(tools.build(response["program"], "cup"))
        tools.submit(name, response)


def pictures(content: Content) -> list[Picture]:
    """Return the pictures of a tool's result."""
    return [entry for entry in content if isinstance(entry, Picture)]


def main(out: Path) -> None:
    """Write the picture."""
    with tempfile.TemporaryDirectory() as folder:
        shown = answer(Path(folder))
        row = [*shown["preview"], *shown["build"], shown["render"][0]]
        images = [Image.fromarray(picture.rgb) for picture in row]
    images = [image.resize((image.width * HEIGHT // image.height, HEIGHT)) for image in images]
    canvas = Image.new("RGB", (sum(i.width + 8 for i in images) - 8, HEIGHT), "white")
    left = 0
    for image in images:
        canvas.paste(image, (left, 0))
        left += image.width + 8
    canvas.save(out / "agent.jpg", quality=85)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

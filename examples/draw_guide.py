"""Render the example programs of the guide, at rest and opened, or given programs, opened.

uv run python examples/draw_guide.py docs/pictures/guide.jpg
uv run python examples/draw_guide.py docs/pictures/objects.jpg examples/objects/*.py
"""

import re
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from neoworld_mjx.program import build
from neoworld_mjx.program.synthesise import guide
from neoworld_mjx.program.views import open_state
from neoworld_mjx.render import render_object

GUIDE, OBJECTS = (360, 300, 3), (250, 210, 6)
"""Width and height of a tile [px], and number of columns: of the guide's and of given programs."""


def main(out: Path, programs: list[Path]) -> None:
    """Build programs, by default those of the guide that state their box; tile their pictures."""
    width, height, columns = OBJECTS if programs else GUIDE
    texts = [path.read_text() for path in programs]
    if not programs:
        blocks = re.findall(r"```python\n(.*?)```", guide(), re.DOTALL)
        texts = [text for text in blocks if "given box" in text]
    tiles = []
    for text in texts:
        spec = build(text).spec
        assert spec is not None
        states = [open_state(spec)] if programs else [{}, open_state(spec)]
        for state in states if open_state(spec) else [{}]:
            tiles.append(render_object(spec, state, width=width, height=height).color)
    empty = [np.full_like(tiles[0], 255)] * (-len(tiles) % columns)
    rows = [np.hstack(row) for row in zip(*[iter([*tiles, *empty])] * columns, strict=True)]
    Image.fromarray(np.vstack(rows)).save(out, quality=88)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])

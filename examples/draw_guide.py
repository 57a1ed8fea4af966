"""Render the example programs of the guide, at rest and opened, into one picture.

uv run python examples/draw_guide.py docs/pictures/guide.jpg
"""

import re
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from neoworld_mjx.program import build
from neoworld_mjx.program.synthesise import guide
from neoworld_mjx.program.views import opened_state
from neoworld_mjx.render import render_object

WIDTH, HEIGHT, COLUMNS = 360, 300, 3


def main(out: Path) -> None:
    """Build the programs that state their box and tile their pictures."""
    blocks = re.findall(r"```python\n(.*?)```", guide(), re.DOTALL)
    tiles = []
    for text in blocks:
        if "given box" not in text:
            continue
        spec = build(text).spec
        assert spec is not None
        for state in ({}, opened_state(spec)) if opened_state(spec) else ({},):
            tiles.append(render_object(spec, state, width=WIDTH, height=HEIGHT).color)
    empty = [np.full_like(tiles[0], 255)] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(row) for row in zip(*[iter([*tiles, *empty])] * COLUMNS, strict=True)]
    Image.fromarray(np.vstack(rows)).save(out, quality=88)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

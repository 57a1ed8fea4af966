"""Carry a test tube into a rack, as in the paper's Section 4.4, and render the motion.

    python examples/test_tube.py test_tube.png

Prints the outcome of the reference plan, and of the same plan with the rack displaced by 2 cm, and
writes six frames of the first as a picture.
"""

import sys
from pathlib import Path

from neoworld_bench.tasks import execute, find_task
from neoworld_bench.tasks.picture_strip import picture_strip
from PIL import Image

MOMENTS = (0.02, 1.4, 2.6, 4.2, 5.3, 7.9)


def main(out: Path) -> None:
    """Execute the plans and write the picture."""
    task = find_task("tube_into_rack")
    print(task.instruction)
    print("reference plan:", execute(task.scene, task.plan, task.predicate))
    x, y = task.scene.object("tube_rack").xy
    off = task.with_object("tube_rack", xy=(x + 0.02, y))
    print("rack 2 cm off:", execute(off, task.plan, task.predicate))
    strip = picture_strip(task, MOMENTS, azimuth_deg=50.0)
    width = strip.width // 2
    picture = Image.new("RGB", (width, 2 * strip.height))
    picture.paste(strip.crop((0, 0, width, strip.height)), (0, 0))
    picture.paste(strip.crop((width, 0, strip.width, strip.height)), (0, strip.height))
    picture.save(out)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "test_tube.png"))

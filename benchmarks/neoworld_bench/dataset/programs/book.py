# Label: book
from neoworld_mjx.program.sdk import Object, box

depth = 0.15  # 0.1 to 0.26 m
width = 0.03  # 0.008 to 0.08 m
height = 0.21  # 0.14 to 0.34 m
colour = "red"  # one of red, blue, green, ochre, black, cream, violet

TONE = {
    "red": (0.6, 0.12, 0.12),
    "blue": (0.14, 0.25, 0.5),
    "green": (0.16, 0.36, 0.24),
    "ochre": (0.78, 0.56, 0.2),
    "black": (0.13, 0.13, 0.14),
    "cream": (0.88, 0.83, 0.7),
    "violet": (0.38, 0.22, 0.45),
}
book = Object("book", label="book")
cover = book.material("cover", like="paper", friction=0.5, rgb=TONE[colour], pattern="plain")
page = book.material("page", like="paper", friction=0.5, rgb=(0.93, 0.91, 0.84), pattern="plain")
body = book.part("body", material=cover)
# The spine is the front; it stands on its lower edge.
BOARD = 0.002
for side, y in (("left", width / 2), ("right", -width / 2)):
    body.add(box((depth, BOARD, height)), at=(0, y, 0), by=f"{side}.bottom")
body.add(box((BOARD, width, height)), at=(depth / 2, 0, 0), by="front.bottom")
pages = box((depth - BOARD - 0.004, width - 2 * BOARD, height - 0.001))
body.add(pages, at=(depth / 2 - BOARD, 0, 0), by="front.bottom", material=page)
band = box((0.0006, 0.8 * width, 0.12 * height))
body.add(
    band, at=(depth / 2 - 0.0003, 0, 0.72 * height), by="back", role="visual", rgb=(0.9, 0.8, 0.5)
)

# Label: book that lies
from neoworld_mjx.program.sdk import Object, box

depth = 0.15  # 0.1 to 0.3 m
width = 0.21  # 0.12 to 0.34 m
height = 0.03  # 0.008 to 0.08 m
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
book = Object("flat_book", label="book that lies")
cover = book.material("cover", like="paper", friction=0.5, rgb=TONE[colour], pattern="plain")
page = book.material("page", like="paper", friction=0.5, rgb=(0.93, 0.91, 0.84), pattern="plain")
body = book.part("body", material=cover)
BOARD = 0.002
body.add(box((depth, width, BOARD)), by="bottom")
body.add(box((depth, width, BOARD)), at=(0, 0, height), by="top")
body.add(box((BOARD, width, height)), at=(depth / 2, 0, 0), by="front.bottom")
pages = box((depth - BOARD - 0.003, width - 0.006, height - 2 * BOARD))
body.add(pages, at=(depth / 2 - BOARD, 0, BOARD), by="front.bottom", material=page)

# Label: book
from neoworld_mjx.program.sdk import Object, box

depth = 0.15  # 0.08 to 0.25 m
width = 0.03  # 0.012 to 0.06 m
height = 0.21  # 0.1 to 0.3 m
cover = "red"  # one of red, blue, green

LOOK = {"red": (0.6, 0.15, 0.15), "blue": (0.15, 0.25, 0.5), "green": (0.15, 0.4, 0.25)}
obj = Object("book", label="book")
obj.material("cover", like="cardboard", density=500, rgb=LOOK[cover])
obj.material("pages", like="paper", density=500)
book = obj.part("book", material="cover")
t = 0.003
for y in (-1, 1):
    book.add(box((depth, t, height)), at=(0, y * (width - t) / 2, 0), by="bottom")
book.add(box((t, width, height)), at=(-depth / 2, 0, 0), by="back.bottom")
pages = (depth - 2 * t, width - 2 * t + 0.001, height - 0.006)
book.add(box(pages), at=(0, 0, 0.003), by="bottom", material="pages")

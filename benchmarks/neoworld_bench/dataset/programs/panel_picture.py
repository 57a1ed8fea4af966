# Label: framed picture
from neoworld_mjx.program.sdk import Object, box

depth = 0.016  # 0.01 to 0.03 m
width = 0.2  # 0.1 to 0.6 m
height = 0.26  # 0.1 to 0.8 m
frame = "walnut"  # one of walnut, oak, black
scene = "sea"  # one of sea, field, sunset

TONE = {"sea": (0.3, 0.5, 0.68), "field": (0.45, 0.6, 0.3), "sunset": (0.88, 0.52, 0.3)}
GROUND = {"sea": (0.16, 0.3, 0.45), "field": (0.62, 0.56, 0.3), "sunset": (0.3, 0.2, 0.3)}
picture = Object("panel_picture", label="framed picture")
like = "oak" if frame == "black" else frame
look = {"rgb": (0.1, 0.1, 0.1), "pattern": "plain"} if frame == "black" else {}
wood = picture.material("frame", like=like, **look)
body = picture.part("body", material=wood)
body.add(box((depth, width, height)), by="bottom")
rim = 0.09 * min(width, height)
size = (width - 2 * rim, height - 2 * rim)
at = (depth / 2 - 0.001, 0, height / 2)
body.add(box((0.001, *size)), at=at, by="back", role="visual", rgb=(0.94, 0.93, 0.9))
inner = (size[0] - rim, size[1] - rim)
at = (depth / 2 - 0.0007, 0, height / 2)
body.add(box((0.001, *inner)), at=at, by="back", role="visual", rgb=TONE[scene])
low = (depth / 2 - 0.0004, 0, height / 2 - inner[1] / 2)
body.add(
    box((0.001, inner[0], 0.4 * inner[1])),
    at=low,
    by="back.bottom",
    role="visual",
    rgb=GROUND[scene],
)

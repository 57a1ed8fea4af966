# Label: toy piano

from neoworld_mjx.program.sdk import Object, box, extrusion, frustum

depth = 0.3  # 0.24 to 0.38 m
width = 0.32  # 0.28 to 0.44 m
height = 0.32  # 0.26 to 0.4 m
keys = 8  # 6 to 10
shape = "upright"  # one of upright, grand
legs = "turned"  # one of turned, square
colour = "red"  # one of red, black, white, blue

PAINT = {"red": (0.7, 0.1, 0.1), "black": (0.1, 0.1, 0.11), "blue": (0.2, 0.4, 0.65)}
obj = Object("toy_piano", label="toy piano")
paint = obj.material("paint", like="pine", rgb=PAINT.get(colour, (0.92, 0.92, 0.89)))
ivory = obj.material("ivory", like="plastic", density=350, rgb=(0.95, 0.94, 0.88))
ebony = obj.material("ebony", like="abs", density=350, rgb=(0.1, 0.1, 0.11))
WALL, back, front = 0.012, -depth / 2, depth / 2
LEG = 0.38 * height
bed = LEG + 0.03
long, inner = 0.36 * depth, width - 2 * WALL
x = front - 0.006
body = obj.part("case", material=paint)
body.add(box((depth, width, 0.03)), at=(0, 0, LEG), by="bottom")
for fx in (front - 0.025, back + 0.025):
    for y in (-width / 2 + 0.025, width / 2 - 0.025):
        leg = (
            frustum(0.009, 0.016, LEG + 0.001)
            if legs == "turned"
            else box((0.03, 0.03, LEG + 0.001))
        )
        body.add(leg, at=(fx, y, 0), by="bottom")
cheek_z = bed + 0.035
for y in (-width / 2, width / 2):
    side = "left" if y > 0 else "right"
    cheek = box((depth, WALL, cheek_z - bed + 0.001))
    body.add(cheek, at=(back, y, bed - 0.001), by=f"back.bottom.{side}")
body.add(box((0.006, inner, 0.012)), at=(front, 0, bed - 0.001), by="front.bottom")
board_x = x - long - 0.003
if shape == "upright":
    low, top = bed - 0.001, height - 0.012
    for y in (-width / 2, width / 2):
        side = "left" if y > 0 else "right"
        wall = box((board_x - back, WALL, top - low))
        body.add(wall, at=(back, y, low), by=f"back.bottom.{side}")
    body.add(box((WALL, inner + 0.002, top - low)), at=(back, 0, low), by="back.bottom")
    body.add(box((WALL, inner + 0.002, top - bed - 0.03)), at=(board_x, 0, top), by="front.top")
    lid = obj.part("lid", material=paint)
    lid.add(box((board_x - back + 0.008, width, 0.0115)), at=(back, 0, height), by="back.top")
    hinge = (back, 0, height - 0.0115)
    obj.revolute("lid_hinge", body, lid, at=hinge, axis=(0, -1, 0), range=(0, 1.5), friction=0.3)
else:
    # A grand has a lid hinged at its left side, held open like a wing.
    body.add(box((WALL, inner + 0.002, cheek_z - bed)), at=(back, 0, bed - 0.001), by="back.bottom")
    body.add(box((WALL, inner + 0.002, 0.014)), at=(board_x, 0, cheek_z), by="front.top")
    desk = obj.part("music_desk", material=paint)
    at = (board_x, 0, cheek_z + 0.0005)
    desk.add(box((0.008, 0.7 * inner, height - at[2])), at=at, by="front.bottom")
    obj.revolute(
        "desk_fold",
        body,
        desk,
        at=(board_x, 0, at[2]),
        axis=(0, 1, 0),
        range=(0, 1.4),
        friction=0.3,
    )
    lid = obj.part("lid", material=paint)
    corner = board_x - WALL - 0.002
    wing = [
        (back, -width / 2),
        (corner, -width / 2),
        (corner, width / 2),
        (back + 0.4 * depth, width / 2),
        (back, 0.1 * width),
    ]
    lid.add(extrusion(wing, 0.01), at=(0, 0, cheek_z + 0.0055))
    hinge = (0, -width / 2, cheek_z + 0.0005)
    obj.revolute("lid_hinge", body, lid, at=hinge, axis=(1, 0, 0), range=(0, 1.0), friction=0.5)

# Keys turn about their far end, where they lie on a rail; in front they have room to go down.
rail_z = bed + 0.008
body.add(box((0.02, inner, 0.009)), at=(x - long + 0.004, 0, bed - 0.001), by="front.bottom")
pitch = inner / keys
drop = 0.006 / long
for k in range(keys):
    key = obj.part(f"white_{k + 1}", material=ivory)
    y = -inner / 2 + (k + 0.5) * pitch
    key.add(
        box((long, pitch - 0.0015, 0.012)), at=(x - 0.0015, y, rail_z + 0.0005), by="front.bottom"
    )
    pivot = (x - long, y, rail_z + 0.0005)
    obj.revolute(
        f"white_{k + 1}_press", body, key, at=pivot, axis=(0, 1, 0), range=(0, drop), friction=0.08
    )
for k in range(keys - 1):
    if k % 7 in (2, 6):
        continue
    key = obj.part(f"black_{k + 1}", material=ebony)
    y = -inner / 2 + (k + 1) * pitch
    z = rail_z + 0.0148
    key.add(box((0.6 * long, 0.45 * pitch, 0.01)), at=(x - long - 0.002, y, z), by="back.bottom")
    pivot = (x - long - 0.002, y, z)
    obj.revolute(
        f"black_{k + 1}_press",
        body,
        key,
        at=pivot,
        axis=(0, 1, 0),
        range=(0, 0.032),
        friction=0.08,
    )

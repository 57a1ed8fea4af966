# Label: cardboard box
# PartNet-Mobility: Box
from neoworld_mjx.program.sdk import Object, box, hollow_box

depth = 0.3  # 0.2 to 0.5 m
width = 0.4  # 0.25 to 0.6 m
height = 0.25  # 0.12 to 0.45 m
closure = "flaps"  # one of flaps, lid
tape = "yes"  # one of yes, no
print_ = "arrow"  # one of arrow, label, none
colour = "brown"  # one of brown, white, black

WALL, AIR = 0.004, 0.0006
parcel = Object("cardboard_box", label="cardboard box")
tones = {"brown": (0.72, 0.56, 0.38), "white": (0.93, 0.92, 0.9), "black": (0.16, 0.15, 0.15)}
parcel.material("board", like="cardboard", rgb=tones[colour])
body = parcel.part("body", material="board")
inner = height - 2 * (
    WALL + AIR
)  # top of the walls at the sides; the other two reach a flap higher
TUCK = WALL + 0.001 if closure == "lid" else 0.0
deep = depth - TUCK
middle = -TUCK / 2
x, back = middle + deep / 2, middle - deep / 2
body.add(hollow_box((deep, width, inner), WALL, open="+z"), at=(middle, 0, 0), by="bottom")
for edge, by in ((x, "front"), (back, "back")):
    body.add(box((WALL, width, WALL + AIR)), at=(edge, 0, inner - 0.0001), by=f"{by}.bottom")
if print_ == "arrow":
    for y in (-0.32, -0.24):
        body.add(
            box((0.001, 0.012, 0.3 * inner)),
            at=(x, y * width, 0.5 * inner),
            rgb=(0.1, 0.1, 0.1),
            role="visual",
        )
        tip = box((0.001, 0.03, 0.03))
        body.add(
            tip,
            at=(x, y * width, 0.65 * inner),
            rpy=(0.7854, 0, 0),
            rgb=(0.1, 0.1, 0.1),
            role="visual",
        )
elif print_ == "label":
    body.add(
        box((0.001, 0.35 * width, 0.35 * inner)),
        at=(x, 0.15 * width, 0.55 * inner),
        rgb=(0.97, 0.97, 0.97),
        role="visual",
    )
    for k in range(4):
        line = box((0.0012, 0.25 * width, 0.02 * inner))
        body.add(
            line,
            at=(x, 0.15 * width, (0.45 + 0.06 * k) * inner),
            rgb=(0.2, 0.2, 0.2),
            role="visual",
        )
if tape == "yes" and closure == "flaps":
    for edge in (x, back):
        body.add(
            box((0.001, 0.05, 0.3 * inner)),
            at=(edge, 0, 0.98 * inner),
            by="top",
            rgb=(0.85, 0.75, 0.5),
            role="visual",
        )

# Two flaps fold in from the sides, below what closes the box.
short = {}
for side, sign in (("left", 1), ("right", -1)):
    flap = parcel.part(f"{side}_flap", material="board")
    reach = min(width / 2, deep / 2) - 0.002
    at = (middle, sign * width / 2, inner + AIR)
    flap.add(box((deep - 2 * WALL - 0.004, reach, WALL)), at=at, by=f"{side}.bottom")
    short[side] = flap
high = height - WALL
if closure == "flaps":
    outer = []
    for side, sign in (("front", 1), ("back", -1)):
        flap = parcel.part(f"{side}_flap", material="board")
        at = (sign * deep / 2, 0, height)
        flap.add(box((deep / 2 - 0.001, width - 0.012, WALL)), at=at, by=f"{side}.top")
        if tape == "yes":
            strip = box((deep / 2 - 0.002, 0.05, 0.0006))
            flap.add(
                strip,
                at=(sign * deep / 2, 0, height),
                by=side,
                rgb=(0.85, 0.75, 0.5),
                role="visual",
            )
        parcel.revolute(
            f"{side}_fold",
            body,
            flap,
            at=f"{side}.hinge",
            range=(0, 2.4),
            opens="up",
            friction=0.06,
        )
        outer.append(flap)
else:
    lid = parcel.part("lid", material="board")
    lid.add(box((deep, width, WALL)), at=(middle, 0, height), by="top")
    outer = [lid]
    parcel.revolute("lid_fold", body, lid, at="back.hinge", range=(0, 1.9), opens="up")
    tuck = parcel.part("tuck", material="board")
    tuck.add(
        box((WALL, 0.9 * width, 0.4 * height)), at=(x + 0.001, 0, height - 0.0002), by="back.top"
    )
    parcel.revolute("tuck_fold", lid, tuck, at="top.hinge", range=(0, 1.4), friction=0.01)
for side, flap in short.items():
    parcel.revolute(
        f"{side}_fold", body, flap, at=f"{side}.hinge", range=(0, 2.4), after=outer, opens="up"
    )

# Label: cooking pot with a lid
# PartNet-Mobility: KitchenPot
import math

from neoworld_mjx.program.sdk import Object, box, cylinder, lathe, sweep

depth = 0.26  # 0.22 to 0.32 m
width = 0.35  # 0.3 to 0.42 m
height = 0.2  # 0.15 to 0.28 m
grips = "loops"  # one of loops, folding, bars
lid_shape = "dome"  # one of dome, flat
vent = "flap"  # one of flap, weight
finish = "steel"  # one of steel, red, black, copper

pot = Object("cooking_pot", label="cooking pot with a lid")
tones = {
    "steel": (0.76, 0.77, 0.79),
    "red": (0.65, 0.1, 0.1),
    "black": (0.12, 0.12, 0.13),
    "copper": (0.72, 0.45, 0.3),
}
pot.material("shell", like="aluminium", rgb=tones[finish])
pot.material("dark", like="abs", rgb=(0.13, 0.13, 0.14))
body = pot.part("body", material="shell")
EAR, KNOB = 0.036, 0.034
r, wide = depth / 2, width / 2 - EAR
oval = wide / r
LID = 0.024 if lid_shape == "dome" else 0.008
rim = height - KNOB - LID - 0.0006
profile = [(0, 0), (0.9 * r, 0), (0.985 * r, 0.02), (0.985 * r, rim - 0.004), (r, rim)]
body.add(lathe(profile, thickness=0.0025, sectors=24, oval=oval), name="shell")

lid = pot.part("lid", material="shell")
cover = [(0, 0), (0.5 * r, 0.1 * LID), (0.85 * r, 0.5 * LID), (0.985 * r, LID)]
lid.add(
    lathe(cover, thickness=0.002, sectors=24, oval=oval),
    at=(0, 0, height - KNOB),
    rpy=(math.pi, 0, 0),
)
peak = height - KNOB
lift = pot.prismatic("lid_lift", body, lid, axis="up", range=(0, 0.12), friction=6)
knob = pot.part("knob", material="dark")
lid.add(cylinder(0.006, 0.012), at=(0, 0, peak - 0.001), by="bottom", material="dark")
knob.add(
    lathe([(0, 0), (0.01, 0), (0.02, KNOB - 0.02), (0.016, KNOB - 0.0115)]),
    at=(0, 0, peak + 0.0115),
)
pot.continuous("knob_turn", lid, knob, at=(0, 0, peak + 0.02), axis="up")
cap = pot.part("vent", material="dark" if vent == "flap" else "brass")
place = (0.45 * r, 0, peak - 0.08 * LID)
if vent == "flap":
    cap.add(cylinder(0.011, 0.003), at=(place[0], 0, peak + 0.0006 - 0.07 * LID), by="bottom")
    pot.revolute("vent_turn", lid, cap, at=(place[0], 0.008, peak), axis="up", range=(0, 2.0))
else:
    cap.add(cylinder(0.009, 0.018), at=(place[0], 0, peak + 0.0006 - 0.07 * LID), by="bottom")
    pot.prismatic("weight_lift", lid, cap, axis="up", range=(0, 0.012))

z = rim - 0.028
edge = 0.985 * wide
for side, sign in (("left", 1), ("right", -1)):
    if grips == "folding":
        # A loop of wire that hangs in an eye and swings up.
        body.add(
            box((0.07, 0.012, 0.014)),
            at=(0, sign * (edge - 0.002), z),
            by="right" if sign > 0 else "left",
        )
        y = sign * (edge + 0.0135)
        loop = pot.part(f"{side}_handle", material="steel")
        out = sign * (width / 2 - 0.003)
        path = [
            (-0.03, y, z),
            (-0.04, y, z),
            (-0.034, out, z),
            (0.034, out, z),
            (0.04, y, z),
            (0.03, y, z),
            (-0.03, y, z),
        ]
        loop.add(sweep(path[:-1], radius=0.003))
        loop.add(cylinder(0.003, 0.07), at=(0, y, z), rpy=(0, math.pi / 2, 0))
        pot.revolute(
            f"{side}_fold",
            body,
            loop,
            at=(0, y, z),
            axis=(sign, 0, 0),
            range=(0, 1.1),
            friction=0.02,
        )
    elif grips == "loops":
        out = sign * (width / 2 - 0.005)
        path = [
            (-0.045, sign * (edge - 0.006), z),
            (-0.045, 0.6 * sign * edge + 0.4 * out, z),
            (-0.035, out, z),
            (0.035, out, z),
            (0.045, 0.6 * sign * edge + 0.4 * out, z),
            (0.045, sign * (edge - 0.006), z),
        ]
        body.add(
            sweep(path, width=0.012, thickness=0.01),
            material="dark" if finish == "steel" else "shell",
        )
    else:
        bar = box((0.08, width / 2 - edge + 0.006, 0.016))
        body.add(
            bar, at=(0, sign * width / 2, z), by="left" if sign > 0 else "right", material="dark"
        )

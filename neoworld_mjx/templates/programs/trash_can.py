# Label: pedal bin
# PartNet-Mobility: TrashCan
import math

from neoworld_mjx.program.sdk import Object, box, hollow_box, lathe, sweep

depth = 0.32  # 0.26 to 0.42 m
width = 0.27  # 0.22 to 0.36 m
height = 0.45  # 0.3 to 0.68 m
shape = "round"  # one of round, box, tapered
bucket = "yes"  # one of yes, no
finish = "steel"  # one of steel, white, red, black

PEDAL, BASE = 0.035, 0.05
bin_ = Object("trash_can", label="pedal bin")
shade = {
    "steel": (0.74, 0.75, 0.77),
    "white": (0.93, 0.93, 0.91),
    "red": (0.7, 0.12, 0.12),
    "black": (0.12, 0.12, 0.13),
}
bin_.material(
    "skin", like="stainless_steel" if finish == "steel" else "polypropylene", rgb=shade[finish]
)
bin_.material("dark", like="abs", rgb=(0.14, 0.14, 0.15))
body = bin_.part("body", material="skin")
deep = depth - PEDAL
x = depth / 2 - PEDAL
centre, wall = x - deep / 2, 0.0015 if finish == "steel" else 0.003
dome = 0.14 * height if shape != "box" else 0.06
rim = height - dome
taper = 0.82 if shape == "tapered" else 1.0
# Between the body's floor and the base is the slot of the pedal.
if shape == "box":
    body.add(hollow_box((deep, width, rim - BASE), wall), at=(centre, 0, BASE), by="bottom")
    body.add(
        box((0.9 * deep, width - 0.02, 0.012)), at=(centre, 0, 0), by="bottom", material="dark"
    )
else:
    r, oval = deep / 2, width / deep
    profile = [(0, 0), (taper * r, 0), (r, rim - BASE)]
    body.add(
        lathe(profile, thickness=wall, sectors=20, oval=oval), at=(centre, 0, BASE), name="shell"
    )
    plate = lathe([(0, 0), (0.97 * taper * r, 0), (0.97 * taper * r, 0.012)], oval=oval)
    body.add(plate, at=(centre, 0, 0), material="dark")
for y in (-0.3 * width, 0.3 * width):
    body.add(
        box((0.5 * deep * taper, 0.02, BASE - 0.01)),
        at=(centre, y, 0.011),
        by="bottom",
        material="dark",
    )

pedal = bin_.part("pedal", material="dark")
bar = pedal.add(
    box((0.55 * deep + PEDAL, 0.3 * width, 0.006)), at=(depth / 2, 0, 0.036), by="front"
)
pedal.add(box((0.035, 0.4 * width, 0.009)), at=(depth / 2, 0, 0.036), by="front", material="steel")
pin = bar.anchor("back")
body.add(box((0.012, 0.5 * width, 0.01)), at=(pin[0] - 0.007, 0, 0.036), material="dark")
body.add(
    box((0.01, 0.5 * width, 0.042)), at=(pin[0] - 0.012, 0, 0.009), by="bottom", material="dark"
)
press = 0.018 / (0.55 * deep + PEDAL)  # it dips to just above the base
bin_.revolute(
    "pedal_press", body, pedal, at=pin, axis=(0, 1, 0), range=(0, press), stiffness=1.2, damping=0.3
)

lid = bin_.part("lid", material="skin")
if shape == "box":
    lid.add(
        hollow_box((deep, width, dome - 0.001), wall, open="-z"), at=(centre, 0, height), by="top"
    )
else:
    cap = [(0, 0), (0.6 * r, 0.1 * dome), (0.9 * r, 0.5 * dome), (r, dome - 0.001)]
    lid.add(
        lathe(cap, thickness=wall, sectors=20, oval=oval),
        at=(centre, 0, height),
        rpy=(math.pi, 0, 0),
    )
hinge = (x - deep, 0, rim + 0.001)
swing = bin_.revolute(
    "lid_hinge",
    body,
    lid,
    at=hinge,
    axis=(0, -1, 0),
    range=(0, 1.4),
    friction=0.4,
    opens="up",
)
if bucket == "yes":
    inner = bin_.part("bucket", material="dark")
    floor, tall = BASE + wall + 0.0005, rim - BASE - 0.045
    if shape == "box":
        inner.add(
            hollow_box((deep - 0.02, width - 0.02, tall), 0.002), at=(centre, 0, floor), by="bottom"
        )
        half = (width - 0.024) / 2
    else:
        low, top = taper * r - 0.012, (taper + (1 - taper) * 0.8) * r - 0.012
        inner.add(
            lathe([(0, 0), (low, 0), (top, tall)], thickness=0.002, oval=oval),
            at=(centre, 0, floor),
        )
        half = (low + (top - low) * (1 - 0.03 / tall)) * oval - 0.003
    handle = bin_.part("bucket_handle", material="steel")
    z, y, out = floor + tall - 0.03, half - 0.0012, centre + 0.22 * deep
    loop = [(centre, -y, z), (out, -0.55 * y, z), (out, 0.55 * y, z), (centre, y, z)]
    handle.add(sweep(loop, radius=0.002))
    bin_.prismatic(
        "bucket_lift", body, inner, axis="up", range=(0, 0.9 * tall), after=swing, damping=30
    )
    fold = (centre, 0, z)
    bin_.revolute(
        "handle_fold", inner, handle, at=fold, axis=(0, -1, 0), range=(0, 1.3), friction=0.03
    )

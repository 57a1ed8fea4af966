# Written by hand through the mailbox, from a picture of the object alone.
from neoworld_mjx.program.sdk import Object, box, hollow_box, sweep

# Wall cabinet, given box 0.36 x 0.90 x 0.72 m: a front of two flaps that folds upwards. Only the
# lower flap has a handle: pulling it lifts the upper one, and the two fold together.
X, Y, Z = 0.36, 0.90, 0.72
PULL, FRONT, WALL = 0.028, 0.018, 0.018
DEPTH = X - PULL - FRONT
SPLIT = 0.355

cabinet = Object("cabinet", label="grey wall cabinet with a folding front")
cabinet.material("light", like="chipboard", rgb=(0.72, 0.72, 0.72))
cabinet.material("front", like="mdf", rgb=(0.66, 0.66, 0.66))
carcass = cabinet.part("carcass", material="light")
shell = carcass.add(hollow_box((DEPTH, Y, Z), WALL, open="+x"), by="bottom")
carcass.add(box((DEPTH - 0.03, Y - 2 * WALL, WALL)), at=(0, 0, SPLIT), name="shelf")
x = shell.anchor("front")[0] + 0.0005

upper = cabinet.part("upper_flap", material="front")
high = upper.add(box((FRONT, Y - 0.002, Z - SPLIT - 0.002)), at=(x, 0, Z - 0.001), by="top.back")
lift = cabinet.revolute(
    "lift", carcass, upper, at=high.anchor("top.back"), axis=(0, -1, 0), range=(0, 1.5)
)
lower = cabinet.part("lower_flap", material="front")
low = lower.add(box((FRONT, Y - 0.002, SPLIT - 0.002)), at=(x, 0, SPLIT - 0.001), by="top.back")
# The lower flap folds back under the upper one, faster than that rises.
cabinet.revolute(
    "fold",
    upper,
    lower,
    at=low.anchor("top.back"),
    axis=(0, 1, 0),
    range=(0, 2.4),
    mimic=lift,
    multiplier=1.6,
)
px, W, H = low.anchor("front")[0], 0.08, 0.05
bar = [(px - 0.002, -W, H), (px + 0.023, -W, H), (px + 0.023, W, H), (px - 0.002, W, H)]
lower.add(sweep(bar, radius=0.005), material="steel", name="handle")

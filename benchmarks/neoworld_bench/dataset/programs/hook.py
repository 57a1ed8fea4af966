# Label: wall hook
from neoworld_mjx.program.sdk import Object, box, sweep

depth = 0.06  # 0.04 to 0.12 m
width = 0.04  # 0.03 to 0.1 m
height = 0.09  # 0.06 to 0.2 m
stuff = "brass"  # one of brass, steel, oak

hook = Object("hook", label="wall hook")
body = hook.part("body", material=stuff)
body.add(box((0.008, width, height)), at=(-depth / 2, 0, 0), by="back.bottom")
out, r = depth / 2 - 0.004, 0.004
path = [
    (-depth / 2 + 0.004, 0, 0.3 * height),
    (out - 0.01, 0, 0.3 * height),
    (out, 0, 0.6 * height),
]
body.add(sweep(path, radius=r))

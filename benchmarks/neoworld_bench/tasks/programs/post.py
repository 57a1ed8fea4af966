# Label: post on a foot
from neoworld_mjx.program.sdk import Object, box, cylinder

depth = 0.12  # 0.08 to 0.2 m
width = 0.12  # 0.08 to 0.2 m
height = 0.12  # 0.05 to 0.3 m
rod = 0.026  # 0.006 to 0.04 m
foot = "walnut"  # one of walnut, oak, steel

obj = Object("post", label="post on a foot")
body = obj.part("foot", material=foot)
body.add(box((depth, width, 0.015)), by="bottom")
body.add(cylinder(rod / 2, height - 0.014), at=(0, 0, 0.014), by="bottom", material="oak")

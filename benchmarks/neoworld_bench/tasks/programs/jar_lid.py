# Label: lid with a knob
from neoworld_mjx.program.sdk import Object, cylinder

depth = 0.094  # 0.05 to 0.26 m
width = 0.094  # 0.05 to 0.26 m
height = 0.04  # 0.03 to 0.08 m
plug = 0.074  # 0.03 to 0.24 m
stuff = "ceramic"  # one of ceramic, steel, oak

PLATE, DEEP = 0.006, 0.01
obj = Object("jar_lid", label="lid with a knob")
obj.material("body", like=stuff, density=1500)
lid = obj.part("lid", material="body")
lid.add(cylinder(plug / 2, DEEP), by="bottom")
lid.add(cylinder(depth / 2, PLATE), at=(0, 0, DEEP - 0.0005), by="bottom")
lid.add(cylinder(0.011, height - DEEP - PLATE + 0.001), at=(0, 0, height), by="top")

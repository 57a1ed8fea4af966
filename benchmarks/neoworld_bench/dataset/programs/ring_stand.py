# Label: ring
from neoworld_mjx.program.sdk import Object, torus

depth = 0.06  # 0.03 to 0.4 m
width = 0.06  # 0.03 to 0.4 m
height = 0.012  # 0.006 to 0.1 m
stuff = "cork"  # one of cork, rubber, steel, oak

ring = Object("ring_stand", label="ring")
r = height / 2
ring.part("body", material=stuff).add(torus(depth / 2 - r, r), by="bottom")

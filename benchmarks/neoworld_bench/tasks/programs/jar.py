# Label: open jar
from neoworld_mjx.program.sdk import Object, cylinder, tube

depth = 0.09  # 0.05 to 0.25 m
width = 0.09  # 0.05 to 0.25 m
height = 0.1  # 0.05 to 0.2 m
wall = 0.005  # 0.003 to 0.008 m
stuff = "ceramic"  # one of ceramic, steel, oak

obj = Object("jar", label="open jar")
obj.material("body", like=stuff, density=2000)
jar = obj.part("jar", material="body")
jar.add(cylinder(depth / 2, 0.008), by="bottom")
jar.add(tube(depth / 2, wall, height - 0.0075, sectors=16), at=(0, 0, 0.0075), by="bottom")

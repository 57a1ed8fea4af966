# Label: ramp
import math

from neoworld_mjx.program.sdk import Object, prism

depth = 0.3  # 0.1 to 1.0 m
width = 0.2  # 0.05 to 1.0 m
height = 0.07  # 0.02 to 0.4 m
stuff = "plywood"  # one of plywood, oak, foam, rubber

ramp = Object("wedge", label="ramp")
# Its high end is at the back.
side = [(-depth / 2, -height / 2), (depth / 2, -height / 2), (-depth / 2, height / 2)]
like = "rubber" if stuff == "rubber" else stuff
skin = ramp.material("skin", like=like, friction=0.7)
body = ramp.part("body", material=skin)
body.add(prism(side, width), at=(0, 0, height / 2), rpy=(math.pi / 2, 0, 0))

# Label: ball
from neoworld_mjx.program.sdk import Object, sphere

depth = 0.045  # 0.02 to 0.08 m
width = 0.045  # 0.02 to 0.08 m
height = 0.045  # 0.02 to 0.08 m
stuff = "rubber"  # one of rubber, oak, fruit

obj = Object("ball", label="ball")
obj.material("skin", like=stuff, rgb=(0.85, 0.35, 0.2))
obj.part("ball", material="skin").add(sphere(height / 2), by="bottom")

# Label: ball
from neoworld_mjx.program.sdk import Object, sphere

depth = 0.07  # 0.02 to 0.3 m
width = 0.07  # 0.02 to 0.3 m
height = 0.07  # 0.02 to 0.3 m
colour = "red"  # one of red, blue, yellow, green, orange, white

TONE = {
    "red": (0.78, 0.15, 0.12),
    "blue": (0.15, 0.32, 0.68),
    "yellow": (0.93, 0.78, 0.2),
    "green": (0.4, 0.62, 0.2),
    "orange": (0.92, 0.52, 0.12),
    "white": (0.93, 0.93, 0.92),
}
ball = Object("ball", label="ball")
skin = ball.material("skin", like="fruit", friction=0.6, rgb=TONE[colour])
ball.part("body", material=skin).add(sphere(depth / 2), by="bottom")

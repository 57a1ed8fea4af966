"""Evidence that the user of a photograph has: its camera, a depth image, masks.

`Evidence` holds all of it. `known_camera` applies a camera to a scene tree, `depth_image` and
`masks` hold images that are registered with the photograph.
"""

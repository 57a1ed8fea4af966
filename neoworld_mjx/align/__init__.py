"""Alignment of a composed scene with the pixels of its photograph.

`align` estimates the camera and the layout together by Gauss-Newton steps:

- `unknowns` places the scene, and `rasterize` renders it.
- `contours` estimates from the photograph's colors how far each contour is displaced (`colors` of
  the whole object, `local_colors` near each point).
- `linear_evidence` linearizes these displacements and the residuals of the parsed 2D boxes, with
  the derivatives of `image_jacobian`.
- `alignment_prior` keeps the solution near the composed scene.
- `normal_equations` solves for the unknowns.
- `acceptance` refuses a move that the pixels do not support.
"""

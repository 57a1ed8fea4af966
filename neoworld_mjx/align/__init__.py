"""Alignment of a composed scene with the pixels of its photograph.

`align` estimates the camera and the layout together by Gauss-Newton steps: `unknowns` places the
scene, `rasterize` draws it, `contours` measures how far the photograph's colors (`colors`) displace
each object's contour, `linear_evidence` linearizes this and the parsed 2D boxes in the unknowns
(`image_jacobian`), `normal_equations` solves for them, `alignment_prior` keeps everything else near
the composition, and `acceptance` refuses a move that the pixels do not support.
"""

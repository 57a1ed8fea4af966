"""Estimate of the camera and the layout from the photograph and all other evidence.

- `fit_tree` fits the camera and the 3D boxes of a tree to its 2D boxes (Step 1), with the outlines
  of categories; `refit` repeats it with built shapes, and `tree_checks` checks a tree without a
  model.
- `align` aligns the composed scene with the pixels (Step 4): `unknowns` places the scene,
  `rasterize` renders it, `normal_equations` linearizes contours, 2D boxes and contacts, and
  `alignment` holds the prior and the result.
"""

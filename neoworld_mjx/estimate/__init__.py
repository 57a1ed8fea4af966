"""Estimate of the camera and the layout from the photograph and all other evidence.

- `align`: the calls of Step 4. `align_to_boxes` moves the built objects to their 2D boxes, `align`
  uses all evidence, `align_again` moves some objects once more.
- `unknowns`: the vector of unknowns, and the scene at its values. `prior`: its prior.
- `rows/`: evidence, linearized: `boxes`, `contours`, `edges`, `depth`, `contacts`, `standing`.
- `problem`: which rows there are at some values. `solve`: their sum, its solution and covariance.
- `depth_start`: where a depth image starts. `views`: cameras of further photographs.
- `image/`: colors, line segments, and renderings of the scene. `result`: what changed.
"""

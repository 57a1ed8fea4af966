"""Fit of camera pose and 3D boxes of a parsed scene to its 2D boxes in the photograph.

- `fit_tree` solves a robust least-squares problem (`fit_problem`). Its residuals are the
  differences between projected outlines (`outline_residuals`, with the shapes of `projection` and
  `wireframe`) and 2D boxes, and between unknowns and parsed values (`priors`). Sides that
  `visible_sides` reports as occluded or cut are ignored.
- `refit` repeats the fit with built shapes.
- `support_selection` replaces infeasible supports.
- `tree_checks` checks a parse without a model.
"""

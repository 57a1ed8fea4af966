"""Fit of camera pose and 3D boxes of a parsed scene to its 2D boxes in the photograph.

`fit_tree` solves a robust least-squares problem (`fit_problem`): residuals
between projected outlines (`outline_residuals`, with the shapes of `projection` and `wireframe`)
and 2D boxes, without the sides that `visible_sides` reports as occluded or cut, and Gaussian priors
(`priors`) at the parsed values. `refit` repeats the fit with built shapes, and `support_selection`
replaces infeasible supports. `tree_checks` checks a parse without a model; `vanishing_points`
estimates the camera from lines.
"""

"""Fit of camera pose and 3D boxes of a parsed scene to its 2D boxes in the photograph.

`fit_tree` solves a robust least-squares problem (`fit_problem`): residuals of projected outlines
(`outline_residuals`, with the shapes of `projection` and `wireframe`) against the 2D boxes, whose
occluded and cut sides `visible_sides` finds, and Gaussian priors (`priors`) at the parsed values.
`refit` repeats it with built shapes, and `support_selection` then changes supports that are not
possible. `tree_checks` checks a parse without a model; `vanishing_points` finds a camera by lines.
"""

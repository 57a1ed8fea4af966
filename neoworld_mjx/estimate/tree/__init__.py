"""Step 1: fit of a parsed tree, with outlines of categories, to its 2D boxes, and its checks."""

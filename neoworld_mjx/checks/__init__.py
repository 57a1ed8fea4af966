"""Checks of a single object: does its program compile to something that can be simulated?

The compile checks (`compile_checks.check`) examine the object at rest, over a sweep of its joints,
and for plausible sizes and masses; each finding is a `Signal` that the author of the program can
act on. The object tests (`object_tests.run_object_tests`) repeat the sweep, simulate the object in
a set of scenarios, and return a `Verdict` on all of their checks. Steps 2 and 3 share this package,
so that both apply the same thresholds to the same measurements.
"""

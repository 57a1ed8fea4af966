"""Checks of a single object: compile checks (Step 2) and object tests (Step 3).

The compile checks (`compile_checks.check`) examine the object with all joints at zero, sweep the
joints over their ranges, and check that sizes and masses are plausible. Each finding is a `Signal`
on which the author of the program can act. The object tests (`object_tests.run_object_tests`)
repeat the sweep, simulate the object in a set of scenarios, and return a `Verdict` on all checks.
Both steps use this package, so they apply equal thresholds to equal measurements.
"""

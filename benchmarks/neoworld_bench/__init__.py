"""The benchmark of neoworld_mjx: scenes, tasks, measures and the suites of `neoworld bench`.

Scenes, one set for each purpose:

- `engines.table_scenes`: generated tables, for the speed and agreement of engines.
- `dataset`: thirty scenes with ground truth, for methods and ablations.
- `fidelity`: forty rendered scenes, for the errors of each step.
- `photographs`: the bundled examples, from photograph to scene.

Packages that run on them:

- `measures`: comparisons with ground truth: objects, joints, surfaces, poses.
- `noise`: errors of responses and programs with measured rates; initial scenes made with them.
- `methods`: the search, its ablations and baselines on the thirty scenes; submissions; coverage.
- `real_poses`: reconstructions of real photographs compared with BOP data.
- `rescues`: scenes of meshes with known errors, repaired.
- `tasks`: 84 manipulation tasks, plans and their execution, task success.
- `engines`: rates of engines, and agreement of their verdicts with C MuJoCo.
- `tables`: figures of their rows, with intervals.

`suites` lists the suites of `neoworld bench run`, `run_suites` runs them, `rows` keeps their rows.
neoworld_mjx imports this package only by name, for the `bench` command and the named scenes of
sweeps.
"""

"""Code shared by several test files, one topic per file.

Independent references:

- `reference`, `reference_ekf`: the paper's filter, controller, cost and search, and the invariant
  Kalman filter, in plain NumPy. They share no code with the package.
- `fuzzy_readers`: third-party readers of a controller's files.
- `compiled_c`: an exported filter, compiled and run.

What goes in:

- `experiments`: the paper's with single values changed, very small ones, any scenarios.
- `controllers`: parameter vectors k and fuzzy controllers.
- `measurements`: poses, truth and measurements, random or of the paper's motion.
- `filters`: the observer's settings and states.
- `recordings`: short motions as a recording's arrays.
- `searches`: objectives, and an optimiser with known positions.
- `generated`: thousands of configurations and calls as a careless user might make them.

Outputs, made up without a run:

- `results`: results, with evaluations and numerical trust.
- `schedules`: results with a given controller, for exports and streams.
- `stored`: a stored file that was altered, with the digest of what it now holds.

`arrays` compares to the last bit, `messages` looks for facts in a text, and `figures` finds what a
figure shows.
"""

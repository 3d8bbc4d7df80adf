"""What several files of tests share, one idea a file.

Independent answers:

- `reference`, `reference_ekf`: the paper's filter, controller, cost and search, and the invariant
  Kalman filter, in plain NumPy. They share no code with the package.
- `fuzzy_readers`: other people's readers of a controller's files.
- `compiled_c`: an exported filter, compiled and run.

What goes in:

- `experiments`: the paper's with single values changed, very small ones, scenarios of any kind.
- `controllers`: parameter vectors k and fuzzy controllers.
- `measurements`: poses, truth and measurements, at random or of the paper's motion.
- `filters`: the observer's settings and states.
- `recordings`: short motions as a recording's arrays.
- `searches`: objectives, and an optimiser whose every position is known.
- `generated`: configurations and calls as a careless user might make them, by the thousand.

What comes out, made up without a run:

- `results`: results, and the evaluations and trust in them.
- `schedules`: results with a controller of one's own, for exports and streams.
- `stored`: a stored file that was altered, with the digest of what it now holds.

And `arrays` compares to the last bit, `messages` looks for facts in a text, `figures` tells what a
figure shows.
"""

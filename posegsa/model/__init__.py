"""The paper: motion and sensors, observer, fuzzy gain schedule, simulation and cost.

Pure functions over arrays and small records. Nothing here knows of configurations, optimisers,
files or figures.
"""

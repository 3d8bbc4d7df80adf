"""The paper's model: motion and sensors, observer, fuzzy gain schedule, simulation and cost.

Pure functions over arrays and small records. Nothing here depends on configurations, optimisers,
files or figures.
"""

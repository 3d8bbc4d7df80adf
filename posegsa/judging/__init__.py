"""How good a filter is: metrics, baselines, checks, and comparisons on unseen scenarios."""

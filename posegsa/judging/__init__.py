"""What a schedule is worth: metrics, baselines, trust, and comparisons on unseen scenarios."""

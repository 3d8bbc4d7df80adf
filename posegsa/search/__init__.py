"""From a configuration to a searched parameter vector: scenarios, population, compiled loop."""

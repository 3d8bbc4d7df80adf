"""Files: results, checkpoints and tables, so that nothing already computed is lost."""

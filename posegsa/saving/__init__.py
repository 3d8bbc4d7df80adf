"""What is kept on disk, so that nothing already computed is lost."""

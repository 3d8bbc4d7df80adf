"""What posegsa is measured against, one module each, and the scene that they all compute."""

"""The contenders that posegsa is compared with, a module each, and their common input."""

"""What can be typed, a module for each command.

Nothing here imports JAX, NumPy or any other heavy module: help and refused arguments come at once.
"""

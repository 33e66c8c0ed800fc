"""Lift 2D landmarks in single images to 3D shapes with a convex program."""

__version__ = "0.1.0"

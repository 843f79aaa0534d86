"""Limits of values. Standard library only."""

from __future__ import annotations

MOST_SIDE = 65_536  # pixels along an edge of an image
SCALES = (1e-6, 1e6)  # meters per unit of a capture: from micrometers to a thousand kilometers
# Meters from the origin, of cameras and vertices. Coordinates from the Earth's center have up to 6.4e6, those
# of maps up to 1e7; squares of much larger ones are beyond single precision.
FARTHEST = 1e8
FARTHEST_UNITS = FARTHEST / SCALES[0]  # the same in a capture's own units
UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
UP_SOURCES = ("option", "format", "planes", "cameras")  # what tells which axis of a capture is up

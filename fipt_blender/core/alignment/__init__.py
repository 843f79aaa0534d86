"""Mesh and cameras that do not share coordinates: the similarity from the camera solve to the room's mesh."""

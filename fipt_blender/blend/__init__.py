"""Blender data into plain arrays and back: the room, cameras, UVs, materials, lights, renders."""

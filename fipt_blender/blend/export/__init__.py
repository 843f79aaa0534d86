"""The room for other programs, by Blender's exporters."""

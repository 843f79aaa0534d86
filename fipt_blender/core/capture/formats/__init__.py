"""The readers of captures, one file for each format, and their registry."""

"""Fixtures, added lights and the environment: how they shine, and their conversion to Blender lights."""

"""Balls that show the room's light, and where they can stand."""

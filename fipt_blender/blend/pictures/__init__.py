"""Renders, composites, and their comparison with photographs."""

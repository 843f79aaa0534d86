"""Depth to mesh: range images fused into a truncated signed distance field, and its surface."""

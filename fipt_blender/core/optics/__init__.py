"""Reflection and emission: the BRDF, area lights, the environment; and the denoiser."""

"""Baking the estimate to textures, and the table with which Cycles shows the fitted BRDF."""

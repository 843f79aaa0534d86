"""Estimation of materials: the closed-form initial estimate, the networks and their training."""

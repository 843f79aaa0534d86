"""Radiance of the photographs of this capture that are not HDR: codes, gains and clipped surfaces."""

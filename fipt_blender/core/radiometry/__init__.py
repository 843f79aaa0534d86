"""Photographs that are not HDR: response, exposures, white balances, vignetting, and their errors."""

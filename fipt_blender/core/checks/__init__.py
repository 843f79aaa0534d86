"""Checks of the photographs against each other and the mesh: exposures, camera poses, lamps that it lacks."""

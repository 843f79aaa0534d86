"""What the artist knows of surfaces, between the scene and the run folder."""

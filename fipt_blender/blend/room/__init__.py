"""The room's meshes: export to the engine, the artist's originals, UVs and packing."""

"""Results on the room's objects: materials, maps, and everything taken back."""

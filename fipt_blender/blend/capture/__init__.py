"""The capture in the scene: cameras, views, photographs before and behind the room, coverage."""

"""From Blender to the engine: making its environment, starting its commands, running jobs of many steps."""

"""The engine: Factorized Inverse Path Tracing without Blender (mitsuba, drjit, torch; never bpy)."""

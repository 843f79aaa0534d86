"""The foundation: run folder, settings, messages, errors, checkpoints. It imports no other room."""

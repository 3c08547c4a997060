"""Causes in the system: play, moving gains, slow and periodic disturbances, an odd experiment."""

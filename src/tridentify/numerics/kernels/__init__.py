"""Compiled linear algebra of small systems: cascades and least squares."""

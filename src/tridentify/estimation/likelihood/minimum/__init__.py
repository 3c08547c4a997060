"""Levenberg-Marquardt steps to a stationary point."""

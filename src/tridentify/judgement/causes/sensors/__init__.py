"""Causes in a channel: limits, breaks, lost rows, noise of an input, filters."""

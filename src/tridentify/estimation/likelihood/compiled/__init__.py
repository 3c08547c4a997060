"""Costs, fits and steps in machine code."""

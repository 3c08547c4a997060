"""Estimation with knowledge: what is said of the coefficients beforehand is kept."""

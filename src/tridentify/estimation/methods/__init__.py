"""Estimation methods, one a file, all behind the seam of `tridentify.estimation.methods.base`."""

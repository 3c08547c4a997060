"""States of the on-line estimators as plain values, and whether one from a file can be."""

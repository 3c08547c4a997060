"""Delimited text: how it begins, its cells, rows and columns."""

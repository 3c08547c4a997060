"""Tests of a residual, each allowing for what the others found."""

"""Causes in time: delays, clocks, inputs that act early or were recorded slower."""

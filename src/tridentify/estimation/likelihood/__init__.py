"""The output-error cost: its problem, its value at a denominator, its minimum, the estimate."""

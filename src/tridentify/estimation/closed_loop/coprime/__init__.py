"""Coprime factors of a plant in a fast loop: no unstable polynomial in a denominator."""

"""Models of the measurement noise, its levels, and what they cost the coefficients."""

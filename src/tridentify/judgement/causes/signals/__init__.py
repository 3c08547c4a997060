"""What samples alone say: levels, surprises, converter steps, a start that is no measurement."""

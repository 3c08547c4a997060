"""Beyond the likelihood's maximum: what a short, noisy record says of the poles as a whole."""

"""The three models on-line by the gradient rule of the paper."""

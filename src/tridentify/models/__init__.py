"""The paper's three models, each one linear least-squares problem."""

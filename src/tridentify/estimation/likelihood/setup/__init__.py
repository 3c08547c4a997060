"""The problem: a structure and its records, resolved, with what is linear in it."""

"""File formats: a file in, a record out. One format a file."""

"""How numbers, tables, models and files are written."""

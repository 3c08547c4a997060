"""The compiled sample loops, and where things stand in the vector they work on."""

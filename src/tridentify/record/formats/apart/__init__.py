"""Files decoded in a process of their own."""

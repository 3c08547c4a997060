"""Steps 1 to 4 repeated: where they begin, how they pass on, when the search ends."""

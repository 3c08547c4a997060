"""From records and a structure to an estimate: cost, search, knowledge, methods, answer."""

"""How far an answer may be trusted: other causes, cautions, validation, orders, advice."""

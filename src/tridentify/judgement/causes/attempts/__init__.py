"""The present explanation and others that are fitted beside it, and the rule that names one."""

"""The rivals that filter the record: state-variable filters and instrumental variables."""

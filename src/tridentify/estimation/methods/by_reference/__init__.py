"""The reference route: what the reference of a loop drives, fitted until it stands still."""

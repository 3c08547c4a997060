"""What the field does in closed loop, with a reference: rivals of the reference route."""

"""Records taken in closed loop, with the reference of the loop: what the reference drives."""

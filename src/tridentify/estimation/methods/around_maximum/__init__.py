"""What goes on around one maximum: delays, knowledge, noise, levels and robust losses, in turn."""

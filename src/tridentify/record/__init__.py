"""What was measured: input, output, time, units; files to records."""

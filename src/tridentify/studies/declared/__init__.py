"""Studies that a file declares: systems, inputs, noises and methods, every one with every other."""

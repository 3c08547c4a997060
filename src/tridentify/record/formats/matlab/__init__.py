"""MATLAB files, whatever version wrote them."""

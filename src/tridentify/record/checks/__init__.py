"""Checks of what users hand over: anything in, clean values or the right exception out.

One file for each noun that is built from them. They know none of the nouns themselves.
"""

"""Samples that arrive line by line: bytes in, whole lines, rows of numbers, steps in time.

`sources` gives bytes as they come, `lines` cuts whole lines out of them, `rows` reads numbers and
says what is wrong with the lines that have none, `timeline` turns a column of time into intervals.
Nothing here keeps more than a bounded piece of what went through it.
"""

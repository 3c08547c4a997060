"""Time in files: columns of time, dates, serial days, and clocks that go forward or back."""

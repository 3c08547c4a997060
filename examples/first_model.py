"""A first model: a record, an order, the coefficients with their errors, and a page to show.

python examples/first_model.py [FOLDER]
"""

import sys
from pathlib import Path

from tridentify import identify
from tridentify.data import short_period
from tridentify.report import write_report

record = short_period().select(outputs=["q"])  # or read_record("flight.csv", inputs=..., ...)
estimate = identify(record, poles=2, zeros=1)
print(estimate.summary())

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/examples")
folder.mkdir(parents=True, exist_ok=True)
print("see", write_report(estimate, record, folder / "first_model.html"))

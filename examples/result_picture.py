"""The picture of the README: the shipped record, measured against model, and the Bode diagram."""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from tridentify import Structure, frequency_response, identify
from tridentify.data import short_period
from tridentify.plots import plot_bode, plot_fit


def main() -> None:
    """Write ``result.png``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/static"), help="folder")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    record = short_period().select(outputs=["q"])
    estimate = identify(record, Structure(poles=2, zeros=1))
    figure = plt.figure(figsize=(10.0, 4.2), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=[1.15, 1.0])
    plot_fit(estimate, record, axes=left.subplots(2, 1, sharex=True))
    plot_bode(estimate, measured=frequency_response(record), axes=right.subplots(2, 1, sharex=True))
    figure.savefig(folder / "result.png", dpi=100)
    print(estimate.summary())


if __name__ == "__main__":
    main()

"""What the filters of all experiments are given, as flat arrays for machine code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tridentify.models.experiment import Experiment
from tridentify.numerics.arrays import Array, Indices


class FlatCharts(NamedTuple):
    """The charts of all experiments.

    Attributes
    ----------
    table : (n_charts, 19) int array
        Experiment; numbers of samples, known columns, outputs, weights; degree of the inputs; where
        the impulse acts; of a coloured noise its order and the sizes of gain and scale; then where
        in ``numbers`` begin ``w``, ``begun``, ``known``, ``y``, ``weight``, ``noise``,
        ``seen``, ``gain`` and ``scale``.
    numbers : flat array
    firsts, parts : (n_charts, n_inputs) arrays
    intervals : (n_charts,) array
        All as of `compiled_regression.triangles_of`.
    which, place : (n_experiments, n_outputs) int arrays
        The chart of every output, and its place there.
    counts : (n_outputs,) array
        Samples used.
    """

    table: Indices
    numbers: Array
    firsts: Indices
    parts: Array
    intervals: Array
    which: Indices
    place: Indices
    counts: Array

    @classmethod
    def of(cls, experiments: Sequence[Experiment]) -> FlatCharts | None:
        """None where an experiment has no charts, or other nuisance terms than the first.

        Neither where coloured noise has a level of its own.
        """
        first = experiments[0]
        size = len(experiments), first.y.shape[1]
        which, place = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int64)
        table: list[list[int]] = []
        counts = np.zeros(size[1])
        pieces: list[Array] = []
        others, at = [], 0
        for e, experiment in enumerate(experiments):
            own = experiment.free, experiment.offset, experiment.drift
            if experiment.charts is None or own != (first.free, first.offset, first.drift):
                return None
            if experiment.scale is not None and experiment.is_coloured:
                return None  # innovations are weighted after they were made (`regression`)
            for chart in experiment.charts:
                dt, degree, w, firsts, parts, begun, known, y, weight, _, start = chart.given
                noise, seen, gain, scale = chart.colour or (np.zeros(0),) * 4
                for k, i in enumerate(chart.outputs):
                    which[e, i], place[e, i] = len(table), k
                    counts[i] += chart.counts[k]
                some = [w, begun, known, y, weight, noise, seen, gain, scale]
                starts = at + np.cumsum([0, *(one.size for one in some)])
                at = int(starts[-1])
                pieces += [one.ravel() for one in some]
                sizes = y.shape[1], known.shape[0], y.shape[0], weight.size
                colour = noise.size, gain.shape[0], scale.size
                table.append([e, *sizes, degree, start, *colour, *starts[:-1].tolist()])
                others.append((firsts, parts, dt))
        firsts, parts, intervals = (np.array(one) for one in zip(*others, strict=True))
        flat = np.concatenate(pieces).astype(np.float64, copy=False)
        return cls(np.array(table), flat, firsts, parts, intervals, which, place, counts)

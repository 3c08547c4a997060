"""Where things stand in the vector of an on-line estimator, and the limits of its judgement.

`online.kernels.intake` says what they mean. The compiled loops and the plans that are made for them
read these numbers; nothing is compiled when this module is imported.
"""

from __future__ import annotations

# slots of x
COUNT, TIME, FLAGS, SEEN, EVENT, TICK, SINCE, FIRST, FILLED, ALARM, BORN, EXTRA = range(12)
# of the work beside the stream (`online.task`): samples that it is about, slices that are done; the
# sample since which a change is suspected; and while it is, the ticks of the method itself and of
# the suspicion, the first of which is that of the estimator (`online.suspecting`)
WORK_AT, WORK_DONE, SUSPECT = 16, 17, 18
OWN_TICK, DUE = 12, 19
# the three models have no use for these two ticks: in their places the sample since which the clock
# looks without an alarm, and that of the first of several such looks; zero where there was an alarm
FIRST_LOOK, LOOK = OWN_TICK, DUE
INBOX = 20
"""Place in x of the sample that comes in; what a method holds follows."""

# places in ints
(
    INPUTS, OUTPUTS, ORDER, COLUMNS, FREE, BEGIN, LINE, AT_LINE, AT_WATCH, WATCH, AT_ROW,
    AT_WORK, AT_FACTOR, FACTOR, OFFSET, DRIFT, UPPER, KIND, BLOCK, AT_CHUNK, CHUNK, C_STEP, C_TAPS,
    C_DIRECT, C_START, AT_REFERENCE, EQUILIBRIUM, COLLECTING, AT_FIRST_INPUT, C_MAPS, C_EXTRA,
    DIRECTIONS, DIRECTIONS_STRIDE, AT_IMPULSE, AT_INPUTS, AT_OUTPUTS, AT_BEFORE, C_OUTPUT, C_BASIS,
    C_MONIC, C_ZEROS, AT_THETA, AT_GAIN, AT_COVARIANCE, FILTERING, WALKERS, C_WALK, C_WIDTHS,
    COEFFICIENTS, LEARNING, AT_LARGEST, AT_SCATTER, SCATTER, ALERT,
) = range(54)  # fmt: skip
N_INTS = 72
"""Numbers in the plan of integers, with room."""

# places in c
INTERVAL, FORGETTING, PACE = range(3)
CONSTANTS = 8
"""Numbers at the front of c, with room."""

# places in the watch of an output
(
    LAST, REPEATS, AT_FIRST, HIGHEST, LOWEST, SCALE, SQUARES, WEIGHT, WEIGHT2, MEAN, SPREAD, TAKEN,
    REFUSED, STANDS, LIMITS, INSIDE, IDLE, INNOVATION, FITTED, MOVED,
    BLOCKS, DOUBLES, FLOOR, SCALED,
) = range(24)  # fmt: skip
SCORES = 24
"""Place in the watch of an output behind those above, from which scores and blocks begin."""

# bits of the flags (`online.flags.Flag`)
MISSING_OUTPUT, MISSING_INPUT, JITTER, OUTLIER = 1, 2, 4, 8
STUCK, SATURATED, NOT_EXCITED, CHANGED, NOT_READY = 16, 32, 64, 128, 256

DOUBTED = OUTLIER | STUCK | SATURATED

# bits of the event
CHUNK_FULL, TICKED, ALARMED = 1, 2, 4

FAR, UNSURE = 6.0, 8.0
"""Standard deviations from which a sample is refused: of Gaussian noise one in 500 million, and few
of most others; and by how much more while few samples are known, over the root of their number."""
TOLD, LARGE = 2.0, 3.0
"""Standard deviations that a refused sample counts for the test of a change, and at which others
are cut: what may be an outlier may be a change too, but tells less of one."""
RARE = 0.01
"""Share of samples that repeat the one before, below which a third equal one in a row is a sensor
that hangs."""
MOST_REFUSED = 25
"""Refused samples in a row from which it is not the samples that are wrong."""
LARGEST, SMALLEST = 1e40, 1e-40
"""Largest number that is taken for a sample, and smallest that is not taken for zero: a variance of
a gain, and the product of two, are floats, as off-line (`checks.scales.LARGEST_SIGNAL`)."""
SENSELESS = 1e6
"""How many times larger than the largest so far a sample may be."""
TRACE = 1e-5
"""Share of the output's size that noise has at least: a quiet beginning must not make all that
follows far off."""
FLOOR_PACE = 16
"""Samples after which that size is worked out anew."""
TO_SCALE = 1.4826022185056018  # of a normal's median modulus
MEAN_TO_MEDIAN = 0.8453475393951495
"""Median over mean of a normal's modulus."""
FIRST_SCALED = 20.0
"""Samples whose mean modulus is the first scale: a median needs more."""
SCALE_PACE = 0.004
"""Step of the scale's logarithm with each sample afterwards, up or down to the median: a memory of
some 250 samples."""
BLOCKS_FIRST, BLOCKS_USUAL = 20.0, 200.0
"""Blocks before one is called idle, and the memory of what is usual in blocks."""
LEVEL_OF_DOUBT = 20
"""Of the cumulated sum of a chi-square less twice what is usual of it: a change is suspected from
here, and looked into."""
SCALES, PER_SCALE, SUMS = 3, 16, 4
"""Lengths of blocks that changes are looked for in, each so many times the one before, and numbers
of a test."""
LEVELS, PER_LEVEL = 6, 4
"""Lengths of blocks that the scatter of the scores is found on, each so many times the one
before."""
POWER, NUMBER, UNDER_WAY, HEADER = range(4)  # of the scatter of an output
IDLE_SHARE = 0.01
"""Share of its usual information below which a direction is not excited."""
IDLE_BLOCKS = 8.0
"""Blocks without excitation in a row from which it is told."""
HELD_BLOCKS = 8.0
"""Blocks without excitation in a row from which nothing is learnt, as noise alone would be."""

# kinds of forgetting
EXPONENTIAL, DIRECTIONAL, RESETTING = range(3)
CUT = 0.1
"""Weight that is left of what was learnt, once in a memory, where it is reset."""


def triangle_size(n: int) -> int:
    """Numbers that a triangle of ``n`` columns takes (`numerics.recursive`).

    ``d`` (n), ``t`` (n), the largest entry of every column (n), the information that arrives (n),
    and the rows of ``U`` to the right of the diagonal.
    """
    return 4 * n + n * (n - 1) // 2


def scatter_size(k: int) -> int:
    """Numbers that the scatter of the scores of ``k`` directions takes (`online.kernels.intake`).

    Sum of squares of the scaled innovations, samples, the sum of the block under way, ``M`` (lower
    triangle), then for each level the scores of the block that is under way (k), its blocks of the
    level below, the blocks so far, and the sum of ``S S'`` (lower triangle).
    """
    return HEADER + k * (k + 1) // 2 + LEVELS * (k + 2 + k * (k + 1) // 2)

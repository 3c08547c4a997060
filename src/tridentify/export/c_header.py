"""A discretised model as a C99 header: one struct, one function to start it, one for each step.

The file needs nothing but a C99 compiler, allocates nothing, and depends on nothing that changes
(no dates): the same model gives the same bytes. Numbers have 17 digits (9 in single precision), so
they are read back exactly.

    filter_t filter;
    filter_init(&filter);
    for (;;) filter_step(&filter, u, y);      /* u at this instant in, y at this instant out */

The difference equations are those of `tridentify.export.discrete`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from tridentify.errors import OptionError, SampleTypeError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.export.discrete import Block, Method, blocks_of
from tridentify.export.words import in_c_comment
from tridentify.numerics.arrays import Array
from tridentify.transfer_function import TransferFunction
from tridentify.writing.files import write_atomically
from tridentify.writing.layout import format_std

Number = Literal["double", "float"]

KEYWORDS = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if
    inline int long register restrict return short signed sizeof static struct switch typedef union
    unsigned void volatile while""".split()  # noqa: SIM905
)
PER_LINE = 3


def write_c_header(
    model: TransferFunction | Estimate,
    dt: float,
    path: str | os.PathLike[str],
    *,
    method: Method = "zoh",
    prewarp: float | None = None,
    number: Number = "double",
    name: str | None = None,
) -> Path:
    """Write a model as a filter in C.

    Parameters
    ----------
    model : TransferFunction or Estimate
        Of an estimate the coefficients with their standard errors and the units stand in a comment;
        offset, drift and initial state are not exported: the filter begins at rest.
    dt : float
        Sampling interval at which the filter will be called [s].
    path : path-like
        Of the header.
    method : {"zoh", "tustin"}
        Exact for an input that is held between the samples, or Tustin's method.
    prewarp : float, optional
        Where Tustin's frequency response is exact [rad/s]; at zero by default.
    number : {"double", "float"}
        Of the C code.
    name : str, optional
        What names in the file begin with; that of the file by default.

    Returns
    -------
    Path

    Raises
    ------
    OptionError
        `dt`, `method`, `prewarp` or `number` are not usable, or `name` is no C identifier.
    UnsupportedError
        A delay is no whole number of steps with Tustin's method.
    OutputPathError
        The file cannot be written; nothing is left behind.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "actuator.h"
    ...     text = write_c_header(TransferFunction([20.0], [1.0, 20.0]), 0.01, path).read_text()
    >>> [line for line in text.splitlines() if line.startswith("static inline")]
    ['static inline void actuator_init(actuator_t *s)', ...]
    """
    text = c_header(
        model, dt, identifier(name, Path(path)), method=method, prewarp=prewarp, number=number
    )
    return write_atomically(path, text)


def c_header(
    model: TransferFunction | Estimate,
    dt: float,
    name: str,
    *,
    method: Method = "zoh",
    prewarp: float | None = None,
    number: Number = "double",
) -> str:
    """The text of `write_c_header`; parameters and errors as there."""
    if number not in ("double", "float"):
        raise OptionError(f"found number={shown(number)}; expected 'double' or 'float'; choose one")
    plant = model.model if isinstance(model, Estimate) else model
    if not isinstance(plant, TransferFunction):
        raise SampleTypeError(
            f"found {type(plant).__name__} in place of a model; expected an Estimate or a "
            "TransferFunction; give what identify gives"
        )
    blocks = blocks_of(plant, dt, method, prewarp)
    length = max(block.memory for block in blocks) + 1
    upper = name.upper()
    lines = [
        *_comment(model, plant, dt, method, prewarp),
        f"#ifndef {upper}_H",
        f"#define {upper}_H",
        "",
        f"#define {upper}_INPUTS {plant.n_inputs}",
        f"#define {upper}_OUTPUTS {plant.n_outputs}",
        f"#define {upper}_DT {_literal(dt, 'double')}",
        "",
        "typedef struct {",
        f"    {number} u[{plant.n_inputs}][{length}]; /* inputs, a ring */",
        "    unsigned int now;",
        *(f"    {number} x{k}[{block.order}];" for k, block in enumerate(blocks) if block.order),
        f"}} {name}_t;",
        "",
        "/* Start at rest. */",
        f"static inline void {name}_init({name}_t *s)",
        "{",
        f"    static const {name}_t rest = {{{{{{0}}}}, 0{', {0}' * _stateful(blocks)}}};",
        "    *s = rest;",
        "}",
        "",
        "/* Inputs at this instant in, outputs at this instant out; then one interval on. */",
        f"static inline void {name}_step({name}_t *s, const {number} *u, {number} *y)",
        "{",
        *_constants(blocks, number),
        *_body(blocks, plant, number, length),
        "}",
        "",
        f"#endif /* {upper}_H */",
        "",
    ]
    return "\n".join(lines)


def _stateful(blocks: tuple[Block, ...]) -> int:
    return sum(block.order > 0 for block in blocks)


def _constants(blocks: tuple[Block, ...], number: Number) -> list[str]:
    lines: list[str] = []
    for k, block in enumerate(blocks):
        if not block.order:
            continue
        n = block.order
        lines += _table(f"f{k}[{n}][{n}]", block.change, number)
        lines += _table(f"g{k}[{n}]", block.new, number)
        if np.any(block.old):
            lines += _table(f"h{k}[{n}]", block.old, number)
        lines += _table(f"c{k}[{len(block.outputs)}][{n}]", block.rows, number)
        lines += [f"    {number} d{k}[{n}];"]
    largest = max(block.order for block in blocks)
    return [*lines, *(["    unsigned int i, j;"] if largest else []), "    unsigned int now;", ""]


def _body(
    blocks: tuple[Block, ...], plant: TransferFunction, number: Number, length: int
) -> list[str]:
    """Store the inputs, sum the outputs, move the states."""
    lines = [f"    s->now = (s->now + 1u) % {length}u;", "    now = s->now;"]
    lines += [f"    s->u[{j}][now] = u[{j}];" for j in range(plant.n_inputs)]
    lines += [f"    y[{i}] = {_literal(0.0, number)};" for i in range(plant.n_outputs)]
    for k, block in enumerate(blocks):
        lines += ["    {"] + [f"    {line}" for line in _step(k, block, number, length)] + ["    }"]
    return lines


def _step(k: int, block: Block, number: Number, length: int) -> Iterable[str]:
    late = block.memory > block.delay
    yield f"    const {number} v0 = {_ring(block.source, block.delay, length)};"
    if late:
        yield f"    const {number} v1 = {_ring(block.source, block.delay + 1, length)};"
    n = block.order
    if n:
        for row, i in enumerate(block.outputs):
            yield f"    for (i = 0; i < {n}u; ++i) y[{i}] += c{k}[{row}][i] * s->x{k}[i];"
    for row, i in enumerate(block.outputs):
        for value, v in ((block.direct[row], "v0"), (block.direct_old[row], "v1")):
            if value:
                yield f"    y[{i}] += {_literal(float(value), number)} * {v};"
    if not n:
        yield "    (void)v0;"
        return
    old = f" + h{k}[i] * v1" if np.any(block.old) else ""
    yield f"    for (i = 0; i < {n}u; ++i) {{"
    yield f"        d{k}[i] = g{k}[i] * v0{old};"
    yield f"        for (j = 0; j < {n}u; ++j) d{k}[i] += f{k}[i][j] * s->x{k}[j];"
    yield "    }"
    yield f"    for (i = 0; i < {n}u; ++i) s->x{k}[i] += d{k}[i];"


def _ring(source: int, back: int, length: int) -> str:
    if not back:
        return f"s->u[{source}][now]"
    return f"s->u[{source}][(now + {length - back}u) % {length}u]"


def _literal(value: float, number: Number) -> str:
    """A C constant that is read back as the same number."""
    if number == "float":
        text = f"{float(np.float32(value)):.9g}"
        end = "f"
    else:
        text, end = f"{value:.17g}", ""
    return (text if any(mark in text for mark in ".en") else text + ".0") + end


def _table(head: str, values: Array, number: Number) -> list[str]:
    """A constant array, a few numbers a line."""
    if values.ndim == 1:
        return [
            f"    static const {number} {head} = {{",
            *_row(values, number, "        "),
            "    };",
        ]
    lines = [f"    static const {number} {head} = {{"]
    for row in values:
        lines += ["        {", *_row(row, number, "            "), "        },"]
    return [*lines, "    };"]


def _row(values: Array, number: Number, indent: str) -> list[str]:
    texts = [_literal(float(value), number) for value in values]
    groups = [texts[k : k + PER_LINE] for k in range(0, len(texts), PER_LINE)]
    return [indent + ", ".join(group) + "," for group in groups]


def _comment(
    model: TransferFunction | Estimate,
    plant: TransferFunction,
    dt: float,
    method: Method,
    prewarp: float | None,
) -> list[str]:
    how = "zero-order hold, exact for a held input" if method == "zoh" else "Tustin's method"
    if prewarp is not None:
        how += f", exact at {prewarp:.6g} rad/s"
    units: Mapping[str, str] = model.units if isinstance(model, Estimate) else {}

    def listed(names: tuple[str, ...]) -> str:
        return ", ".join(f"{k}: {n}{_unit(units, n)}" for k, n in enumerate(names))

    lines = [
        "Made by tridentify. A continuous-time model as a filter for one sampling interval.",
        "",
        f"Sampling interval: {dt:.17g} s. Discretised by {how}.",
        f"Inputs:  {listed(plant.input_names)}",
        f"Outputs: {listed(plant.output_names)}",
    ]
    for i, output in enumerate(plant.output_names):
        for j, source in enumerate(plant.input_names):
            late = f", delayed by {plant.delay[i, j]:.9g} s" if plant.delay[i, j] else ""
            lines += ["", f"{output} / {source}{late}, descending powers of s:"]
            lines += [f"  numerator   {_powers(plant.num[i][j])}"]
            lines += [f"  denominator {_powers(plant.den[i][j])}"]
    if isinstance(model, Estimate):
        lines += ["", "Coefficients with standard errors:"]
        for p in model.parameters.values():
            std = format_std(p.std) if np.isfinite(p.std) else "unknown"
            unit = f" {p.unit}" if p.unit else ""
            lines += [f"  {p.name} = {p.value:.17g} +- {std}{unit}"]
    return ["/*", *(f" * {in_c_comment(line)}".rstrip() for line in lines), " */"]


def _unit(units: Mapping[str, str], name: str) -> str:
    return f" [{units[name]}]" if units.get(name) else ""


def _powers(coefficients: Array) -> str:
    return " ".join(f"{value:.9g}" for value in coefficients)


def identifier(name: str | None, path: Path) -> str:
    """What names begin with: a C identifier that is given, or one made of the file's name."""
    if name is None:
        made = re.sub(r"\W+", "_", path.stem, flags=re.ASCII).strip("_") or "model"
        made = f"m_{made}" if made[0].isdigit() else made
        return f"{made}_" if made in KEYWORDS else made
    if not re.fullmatch(r"[A-Za-z]\w*", name, flags=re.ASCII) or name in KEYWORDS:
        raise OptionError.found("name=", name, "a C identifier", "write for example 'short_period'")
    return name

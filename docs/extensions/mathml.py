"""Formulas as MathML, which browsers show by themselves: no script, no font from elsewhere.

docutils has the converter from LaTeX; Sphinx offers the place to put a renderer.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.math import get_node_equation_number
from sphinx.writers.html5 import HTML5Translator


def convert(latex: str, *, block: bool) -> str:
    """One formula as MathML."""
    try:
        return str(tex2mathml(latex, as_block=block))
    except Exception as error:
        raise ExtensionError(f"formula {latex!r} cannot be shown: {error}") from error


def visit_inline(self: HTML5Translator, node: nodes.math) -> None:
    self.body.append(convert(node.astext(), block=False))
    raise nodes.SkipNode


def visit_block(self: HTML5Translator, node: nodes.math_block) -> None:
    latex = node.astext()
    if r"\\" in latex and r"\begin" not in latex:
        latex = rf"\begin{{aligned}}{latex}\end{{aligned}}"
    number = ""
    if node.get("number"):
        number = f'<span class="eqno">({get_node_equation_number(self, node)})</span>'
    identity = "".join(f' id="{name}"' for name in node.get("ids", ())[:1])
    self.body.append(f'<div class="math"{identity}>{convert(latex, block=True)}{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.config.html_math_renderer = "mathml"
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

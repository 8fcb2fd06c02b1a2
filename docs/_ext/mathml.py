"""Equations as MathML, which browsers draw by themselves: no script, no font, nothing to fetch."""

import re
from html import escape

from latex2mathml.converter import convert

TAG = re.compile(r"\\tag\{(.*?)\}")
COMMAND = re.compile(r"\\[a-z]+")


def inline_math(translator, node):
    """Write an equation within a line."""
    translator.body.append(drawn(node.astext()))
    raise _done()


def display_math(translator, node):
    r"""Write an equation of its own; ``\tag{5}`` says its number in the paper."""
    latex = node.astext()
    found = TAG.search(latex)
    number = f'<span class="equation-number">({escape(found[1])})</span>' if found else ""
    equation = drawn(TAG.sub("", latex).strip(), display="block")
    translator.body.append(f'<div class="equation">{equation}{number}</div>\n')
    raise _done()


def drawn(latex, display="inline"):
    r"""Return an equation as MathML; a command that is not known would be there as text."""
    found = convert(latex, display=display)
    if unknown := COMMAND.search(found):
        raise ValueError(f"the equation {latex} has {unknown[0]}, which cannot be drawn")
    return found


def _done():
    from docutils.nodes import SkipNode

    return SkipNode()


def setup(app):
    """Add the renderer that ``html_math_renderer`` names."""
    app.add_html_math_renderer("mathml", (inline_math, None), (display_math, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""Formulas as MathML, which browsers render by themselves: no script, no network."""

from docutils import nodes
from latex2mathml.converter import convert


def mathml(formula, **how):
    """Return a formula as MathML. Dots and hats are accents, which browsers do not shrink."""
    return convert(formula, **how).replace("<mover>", '<mover accent="true">')


def inline(translator, node):
    """Write an inline formula."""
    translator.body.append(mathml(node.astext()))
    raise nodes.SkipNode


def block(translator, node):
    """Write a formula that stands alone."""
    formula = mathml(node.astext().strip(), display="block")
    translator.body.append(f'<div class="formula">{formula}</div>\n')
    raise nodes.SkipNode


def setup(app):
    """Register the renderer under the name ``mathml``."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}

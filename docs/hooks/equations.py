"""Turn equations into MathML, which browsers draw without a script; name the search for screen readers."""

import re
from html import unescape
from typing import Any

from latex2mathml.converter import convert

SEARCH = '<div class="md-search" data-md-component="search" role="dialog"'
# What the extension pymdownx.arithmatex leaves of an equation.
INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
BLOCK = re.compile(r'<div class="arithmatex">\s*\\\[(.*?)\\\]\s*</div>', re.DOTALL)


def on_page_content(html: str, **_: Any) -> str:
    """Return a page with MathML in place of LaTeX."""
    html = BLOCK.sub(lambda found: convert(unescape(found[1]), display="block"), html)
    return INLINE.sub(lambda found: convert(unescape(found[1])), html)


def on_post_page(output: str, **_: Any) -> str:
    """Return a page whose search dialog has a name."""
    return output.replace(SEARCH, SEARCH + ' aria-label="Search"')

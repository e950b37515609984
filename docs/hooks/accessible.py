"""Name for screen readers what the theme leaves without a name."""

from typing import Any

SEARCH = '<div class="md-search" data-md-component="search" role="dialog"'


def on_post_page(output: str, **_: Any) -> str:
    """Return a page whose search dialog has a name."""
    return output.replace(SEARCH, SEARCH + ' aria-label="Search"')

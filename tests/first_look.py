"""Cases of a test: those of a first look, and the slow ones that `make test-all` adds."""

from collections.abc import Iterable
from typing import Any

import pytest


def cases(names: str, quick: Iterable[Any], slow: Iterable[Any]) -> pytest.MarkDecorator:
    """Parametrize a test; a case of several values is a tuple."""
    each = (one if isinstance(one, tuple) else (one,) for one in slow)
    return pytest.mark.parametrize(names, [*quick, *(pytest.param(*v, marks=pytest.mark.slow) for v in each)])

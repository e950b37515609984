"""Read a `.mat` file of MATLAB 5 to 7.2."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.table_files import TableFile

LEAST_SAMPLES = 10  # of a log; shorter arrays are figures
MOST_DEPTH = 8  # of structures


def read_matlab(path: Path, content: bytes) -> TableFile:
    """Read all arrays of numbers that have as many samples as most.

    Fields of structures are named `a.b.c`, the columns of a matrix `name.1`, `name.2`, ...; samples may run
    along either axis.
    """
    try:
        found = scipy.io.loadmat(io.BytesIO(content), squeeze_me=True)
    except NotImplementedError:
        raise InputError(
            f"{path}: found MATLAB 7.3 (HDF5), expected 5 to 7.2; in MATLAB, save('x.mat', '-v7')"
        ) from None
    except Exception as error:  # scipy raises errors of many kinds
        raise InputError(f"{path}: not a MATLAB file ({shortened(error, 120)})") from None
    arrays = dict(_arrays("", {name: value for name, value in found.items() if not name.startswith("__")}, 0))
    sizes = Counter[int]()
    for values in arrays.values():
        sizes[max(values.shape)] += values.size
    samples = max((n for n in sizes if n >= LEAST_SAMPLES), key=lambda n: (sizes[n], n), default=0)
    if not samples:
        raise InputError(f"{path}: found no array of {LEAST_SAMPLES} numbers or more, expected a log")
    columns = {}
    for name, values in arrays.items():
        if samples not in values.shape:
            continue
        rows = np.moveaxis(values, values.shape.index(samples), 0).reshape(samples, -1).astype(float)
        single = values.ndim == 1
        columns |= {name if single else f"{name}.{k + 1}": rows[:, k] for k in range(rows.shape[1])}
    return TableFile.of_columns(path, columns)


def _arrays(name: str, value: Any, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Walk through structures; the elements of a list of structures are numbered."""
    if depth > MOST_DEPTH:
        return
    if isinstance(value, dict):
        fields = list(value.items())
    elif not isinstance(value, np.ndarray | np.void):
        return
    elif value.dtype.names:
        if value.ndim:
            fields = [(str(k + 1), one) for k, one in enumerate(value.ravel())]
        else:
            fields = [(field, value[field]) for field in value.dtype.names]
    elif value.dtype == object:
        fields = [("", value.item())] if value.size == 1 else []
    else:
        if isinstance(value, np.ndarray) and value.ndim and value.dtype.kind in "iufb":
            yield name, value
        return
    for field, one in fields:
        yield from _arrays(".".join(filter(None, (name, field))), one, depth + 1)

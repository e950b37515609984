"""Describe base parameters in words: first moments of links, and masses at lengths."""

from __future__ import annotations

from typing import Any

import numpy as np

from tulip_testbed.identification.base_parameters import BaseParameters


def base_parameter_words(parameters: BaseParameters, index: int, standard: np.ndarray) -> dict[str, Any]:
    """Describe the index-th base parameter for JSON: number of terms, the largest one, what is summed.

    Args:
        standard: standard parameters of the nominal robot (eq. 5), (n_links, 4) [kg, kg m, kg m, kg m].
    """
    terms = parameters.terms(index)
    links = parameters.tree.links
    sizes = [
        abs(weight * standard[links.index(link), ("m", "mx", "my", "mz").index(quantity)])
        for weight, quantity, link in terms
    ]
    weight, quantity, link = terms[int(np.argmax(sizes))]
    factor = "" if abs(abs(weight) - 1) < 1e-12 else f"{1e3 * abs(weight):.4g} mm "
    return {
        "terms": len(terms),
        "largest": f"{'-' if weight < 0 else ''}{factor}{quantity}[{link}]",
        "meaning": _meaning(terms),
    }


def _meaning(terms: list[tuple[float, str, str]]) -> str:
    moments = [(quantity[1], link) for _, quantity, link in terms if quantity != "m"]
    lengths = sorted({round(1e3 * abs(weight), 1) for weight, quantity, _ in terms if quantity == "m"})
    masses = [link for _, quantity, link in terms if quantity == "m"]
    parts = []
    if moments:
        parts.append(f"{moments[0][0]} moment of {_listed([link for _, link in moments])}")
    if masses:
        at = " or ".join(f"{length:g}" for length in lengths)
        parts.append(
            f"{_listed(masses)} at {at} mm" if len(masses) == 1 else f"{len(masses)} masses at {at} mm"
        )
    return ", ".join(parts)


def _listed(links: list[str]) -> str:
    return " + ".join(links) if len(links) < 3 else f"{len(links)} links from {links[0]}"

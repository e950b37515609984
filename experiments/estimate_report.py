"""An estimate of the base parameters as JSON: for `tulip identify --json` and a validation's report."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tulip_testbed.base.document import Document, Figure, Pair
from tulip_testbed.identification.estimators import Estimate, StandardEstimate
from tulip_testbed.identification.statistics import (
    HIGH_CORRELATION,
    high_correlations,
    relative_standard_errors,
    residual_norms,
    standard_errors,
)


class ParameterRow(Document):
    """A base parameter [m]; truth: null where it is unknown; relative error [%]: null at an estimate of 0."""

    number: int
    name: str
    truth: float | None
    estimate: float
    standard_error: float
    clustered_standard_error: float
    relative_standard_error: Figure


class LinkRow(Document):
    """A link's mass and centre of mass [kg, m]; keys that end in _share: 0 to 1."""

    link: str
    mass: float
    mass_standard_error: float
    mass_data_share: float
    center: list[float]
    center_standard_error: list[float]
    center_data_share: list[float]


class Norms(Document):
    """Distance between measured and estimated centre of pressure over the postures [mm]."""

    mean: float
    sd: float
    max: float


class Correlation(Document):
    """Correlation of two parameters (eq. 15)."""

    a: int
    b: int
    rho: float


class ModelReport(Document):
    """A model's estimate [m, kg; _mm: mm]; links and visible masses from an estimator that gives them."""

    parameters: list[ParameterRow]
    links: list[LinkRow] | None = None
    visible_masses: str | None = None
    sigma_mm: float
    placement_sd_mm: Pair
    condition_number: float
    residual_mm: Norms
    correlations: list[Correlation]


def model_report(estimate: Estimate, truth: np.ndarray | None) -> ModelReport:
    """Report an estimate.

    Args:
        truth: all base parameters, (p,) [m]; None: unknown.
    """
    error = standard_errors(estimate.covariance)
    clustered = standard_errors(estimate.clustered_covariance)
    relative = relative_standard_errors(estimate.value, error)
    norms = residual_norms(estimate.residual)
    pairs = high_correlations(estimate.covariance, estimate.numbers, HIGH_CORRELATION)
    standard = estimate.standard
    links: dict[str, Any] = (
        {} if standard is None else {"links": link_rows(standard), "visible_masses": standard.identifiable}
    )
    return ModelReport(
        parameters=[
            ParameterRow(
                number=number,
                name=estimate.names[k],
                truth=None if truth is None else float(truth[number - 1]),
                estimate=float(estimate.value[k]),
                standard_error=float(error[k]),
                clustered_standard_error=float(clustered[k]),
                relative_standard_error=float(relative[k]),
            )
            for k, number in enumerate(estimate.numbers.tolist())
        ],
        sigma_mm=1e3 * estimate.sigma,
        placement_sd_mm=[1e3 * sd for sd in estimate.placement_sd],
        condition_number=estimate.condition_number,
        residual_mm=Norms(**{key: 1e3 * value for key, value in dataclasses.asdict(norms).items()}),
        correlations=[Correlation(a=a, b=b, rho=rho) for a, b, rho in pairs],
        **links,
    )


def link_rows(standard: StandardEstimate) -> list[LinkRow]:
    """Report masses and centres of mass."""
    return [
        LinkRow(
            link=link,
            mass=float(standard.mass[k]),
            mass_standard_error=float(standard.mass_error[k]),
            mass_data_share=float(standard.mass_share[k]),
            center=standard.center[k].tolist(),
            center_standard_error=standard.center_error[k].tolist(),
            center_data_share=standard.center_share[k].tolist(),
        )
        for k, link in enumerate(standard.links)
    ]

"""Three robots against Pinocchio and FIGAROH, whose answers `make oracle` wrote to tests/data/oracle."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import subspace_angles

from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.kinematics import frame_positions, link_rotations
from tulip_testbed.sim.robot import sole_point

FOLDER = Path(__file__).parent / "data" / "oracle"
SUPPORTS = ("right", "double")


@pytest.fixture(scope="module", params=["tulip", "humanoid", "humanoid_CMU"])
def case(request, robot, foreign):
    """A robot, what we make of it, and what the oracles said."""
    described = ({"tulip": robot} | foreign)[request.param]
    model = described.model
    with np.load(FOLDER / f"{request.param}.npz") as answers:
        return SimpleNamespace(
            robot=described,
            model=model,
            standard=standard_parameters(model),
            parameters={support: base_parameters(described, model, support) for support in SUPPORTS},
            oracle=dict(answers),
        )


def test_oracle_read_the_same_robot(case):
    assert tuple(case.oracle["links"]) == case.parameters["right"].tree.links
    assert case.oracle["mass"] == pytest.approx(case.standard[:, 0].sum(), abs=1e-12)


@pytest.mark.parametrize("support", SUPPORTS)
def test_com_of_the_closed_form(case, support):
    """Mass by mass from the link frames, with no base parameters in between."""
    tree, base = case.parameters[support].tree, case.parameters[support].base
    rotations = link_rotations(tree, base, case.oracle[f"{support}.angles"])
    origin = -sole_point(case.model, case.robot.stance_foot)
    frames = list(tree.frame_of_link)
    positions = frame_positions(tree, base, rotations, origin)[:, frames]
    mass, first_moment = case.standard[:, 0], case.standard[:, 1:]
    turned = np.einsum("mfab,fb->ma", rotations[:, frames], first_moment)
    com = (np.einsum("f,mfa->ma", mass, positions) + turned) / mass.sum()
    assert np.abs(com - case.oracle[f"{support}.com"]).max() < 1e-12


@pytest.mark.parametrize("support", SUPPORTS)
def test_regressor_of_standard_parameters(case, support):
    """Ours goes through the base parameters; Pinocchio's knows no such thing."""
    parameters = case.parameters[support]
    ours = parameters.regressor(case.oracle[f"{support}.angles"]) @ parameters.from_standard
    assert np.abs(ours / case.oracle["mass"] - case.oracle[f"{support}.regressor"]).max() < 1e-12


@pytest.mark.parametrize("support", SUPPORTS)
def test_rank_and_span_of_the_base_parameters(case, support):
    """The same combinations of standard parameters, whichever basis each program picks."""
    ours, figaroh = case.parameters[support].from_standard, case.oracle[f"{support}.mapping"]
    assert len(ours) == len(figaroh)
    assert np.max(subspace_angles(ours.T, figaroh.T)) < 1e-10

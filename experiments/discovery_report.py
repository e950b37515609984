"""discovery.json: a discovery as `tulip discover --json` prints it."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from tulip_testbed.discovery.discover import AMBIGUOUS, Discovery, instance_of
from tulip_testbed.discovery.dynamics_check import DynamicsCheck
from tulip_testbed.discovery.linear_model import Linear
from tulip_testbed.discovery.proposals import Proposal, proposals
from tulip_testbed.discovery.ranking import Rival
from tulip_testbed.discovery.story import story
from tulip_testbed.effects.instance import EffectDocument, EffectInstance, effect_label, split_label
from tulip_testbed.experiments.document import Document, Figure
from tulip_testbed.experiments.identify import Identification

Channel = Literal["A", "F", "T", "C"]
Positive = Annotated[float, Field(gt=0)]


class Named(EffectDocument):
    """An adopted effect with its evidence."""

    log_bayes_factor: float


class Explanation(Document):
    """An effect that explains a gap, with its evidence."""

    gap: int
    name: str
    target: str | None
    parameters: list[SizeRow]
    log_bayes_factor: float

    @property
    def label(self) -> str:
        """Return `name:target`."""
        return effect_label(self.name, self.target)

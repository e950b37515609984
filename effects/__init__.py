"""Physical effects that the nominal laboratory lacks: what they are, and how they are written."""

from tulip_testbed.effects.catalogue import catalogue, explanation
from tulip_testbed.effects.instance import EffectInstance

parse = EffectInstance.parse

__all__ = ["EffectInstance", "catalogue", "explanation", "parse"]

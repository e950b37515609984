"""Names of `Parameter.text` and `EffectInstance.finding` that `discovery` still uses."""

from tulip_testbed.effects.effect import Parameter
from tulip_testbed.effects.instance import EffectInstance

spoken = Parameter.text


def told(found: EffectInstance) -> str:
    """Return the effect as a sentence."""
    return found.finding

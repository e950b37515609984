"""Laws: effects that nobody listed, composed of what errs, as a function of what, and in which shape.

`law:encoder:right_knee/own-angle/sine=0.002,0.0004,1,-0.1,1.2` says that the encoder of the right knee errs
with its own angle like a sine. A law is an `Effect` like those of the catalogue: it can be simulated,
removed, written to a rig folder and estimated. Its curve can be measured; its cause is a guess. So a law
stays within the range of readings in which it was learned: beyond, it keeps the value at the range's end, and
a warning names the postures.
"""

from tulip_testbed.effects.laws.grammar import LAW, Sentence, sentence_of, sentences
from tulip_testbed.effects.laws.law_effect import law_effect

__all__ = ["LAW", "Sentence", "law_effect", "sentence_of", "sentences"]

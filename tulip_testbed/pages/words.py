"""Sentences of pages that views show too."""

NO_TRUE_COM = "The true centre of mass of each posture is not shown: the statics engine does not record it."
VERDICTS = {
    "calibrated": "Ordinary imperfections explain the measurements.",
    "named": "One explanation fits.",
    "described": "A law describes the gap.",
    "ambiguous": "Several explanations fit.",
    "unknown": "No explanation is sufficient.",
    "none": "These postures show no effect that the model lacks.",
}

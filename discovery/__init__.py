"""Find the effects that the nominal model lacks: candidates, evidence, selection, validation, verdict."""

"""Which hypotheses predict best: statistics that add up, one joint fit, and a comparison by
cross-validation."""

"""Which hypotheses predict best: sums that add up, one joint fit, and cross-validation."""

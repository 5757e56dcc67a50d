"""Every number that the diagnosis takes from its authors and not from the recording, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of a diagnosis.

    Attributes
    ----------
    window : length of an energy window [s].  Row noise averages out over it, and a truck passes one or two
    stretches of road.
    stretch : length of path whose travel time is taken together [m]; long against what a braking truck needs.
    folds : of the cross-validation; ten leave 90 % of the training trips to each fit.
    held_out : share of the trips that nothing reads but the final scores.
    material : share of the energy (or travel time) that a mismatch must reach where it acts; the contract's
    2 %.
    gathers : by how much more the model's own error makes up at places, where it gathers: 3 at corners and
    turns of
        clean recordings of three generators.
    evidence : natural logarithm of the odds by which a hypothesis must beat the model without it, and a
    finding its rivals.
        4 is 55 to 1, beside what each hypothesis pays for being one of many.
    consistency : standard errors by which the gain must exceed zero over the folds; 3 is one in a hundred
    for ten folds.
    parameter : evidence that each fitted number costs; half the logarithm of the number of independent
    windows.
    most_findings : findings in one channel; more than six were never told apart in any test.
    shortlist : hypotheses that are fitted exactly after the linear screening.
    model_error : share of a window's energy that the motion between rows keeps any model from explaining, at
    least.
    alike : share of the error of sampling that is alike in windows of one kind, so that it passes for
    physics.
    at_floor : an error is at the noise floor up to this multiple of it; the floor itself is known to some
    20 %.
    profile_error : the same of a window's travel time, as drivers keep no constant accelerations and cut
    corners: what
        unseen trips confirm of false numbers and curves is 3.2 % at most, on clean recordings of three
        generators.
    widening : of standard errors, for what the motion and the model's form shift in all trips alike.
    Without it 21 of 30
        intervals of the benchmark's development seed hold the truth, as 1 / 1.9 of the width would.
    fewest : windows from which on a channel is judged: some ten for each class of power, in each half.
    sample : windows of the sample on which noise is measured and hypotheses are compared.
    """

    window: float = 10.0
    stretch: float = 12.0
    folds: int = 10
    held_out: float = 0.2
    material: float = 0.02
    gathers: float = 3.0
    evidence: float = 4.0
    consistency: float = 2.6
    parameter: float = 4.0
    most_findings: int = 6
    shortlist: int = 6
    model_error: float = 0.01
    alike: float = 0.2
    profile_error: float = 0.035
    at_floor: float = 1.5
    widening: float = 2.0
    fewest: int = 60
    sample: int = 20_000


SETTINGS = Settings()

"""Every number that the diagnosis takes from its authors and not from the recording, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """Settings of a diagnosis."""

    # Length of an energy window [s]: row noise averages out, and a truck passes one or two stretches of road.
    window: float = 10.0
    # Length of path whose travel time is taken together [m]; long against what a braking truck needs.
    stretch: float = 12.0
    folds: int = 10  # Of the cross-validation; ten leave 90 % of the training trips to each fit
    held_out: float = 0.2  # Share of the trips that nothing reads but the final scores
    # Share of the energy (or travel time) that a mismatch must reach where it acts; the contract's 2 %.
    material: float = 0.02
    # The model's own error gathers so much at places: 3 at corners of clean recordings of three generators.
    gathers: float = 3.0
    heights: float = 0.02  # Error of the heights of a map [m]; floors alone deviate 12 mm in 10 m (DIN 18202)
    # Natural logarithm of the odds by which a hypothesis must beat the model without it, and a finding its
    # rivals.  4 is 55 to 1, beside what each hypothesis pays for being one of many.
    evidence: float = 4.0
    # Standard errors by which the gain must exceed zero over the folds; 3 is one in a hundred for ten folds.
    consistency: float = 2.6
    # Evidence that each fitted number costs; half the logarithm of the number of independent windows.
    parameter: float = 4.0
    most_findings: int = 6  # Findings in one channel; more than six were never told apart in any test
    shortlist: int = 6  # Hypotheses that are fitted exactly after the linear screening
    # Share of a window's energy that the motion between rows keeps any model from explaining, at least.
    model_error: float = 0.01
    # Share of the error of sampling that is alike in windows of one kind, so that it passes for physics.
    alike: float = 0.2
    # The model's error of a window's travel time, as drivers keep no constant accelerations and cut corners:
    # unseen trips of clean recordings of three generators confirm false numbers and curves of 2.3 % at most.
    profile_error: float = 0.0275
    # An error is at the noise floor up to this multiple of it; the floor itself is known to some 20 %.
    at_floor: float = 1.5
    # Of standard errors, for what the motion and the model's form shift in all trips alike.  Without it 21 of
    # 30 intervals of the benchmark's development seed hold the truth, as 1 / 1.9 of the width would.
    widening: float = 2.0
    # Windows from which on a channel is judged: some ten for each class of power, in each half.
    fewest: int = 60
    sample: int = 20_000  # Windows on which noise is measured and hypotheses are compared, at most; or half
    of_truck: int = 550  # as many: so many of each truck then, an hour and a half, tell its own effects


SETTINGS = Settings()

"""Time lost to other trucks."""

from fleetlog.physics.term import Parameter, Term

# Nothing of its own: it comes of driving among others, as the simulator does with ``--together``.
TERM = Term(
    "congestion", "traffic",
    "trucks lose time to one another: behind another, and before crossings that another uses",
    (Parameter("share", "1", 0.0, 1.0),), field=True, one_way=True, depends_on=("x", "y", "time"),
    sentence="{share.value:.1%} of the travel time ({share.low:.1%} to {share.high:.1%}) is lost to other "
    "trucks, behind them or before crossings that they use, most of it {where}",
    needs="record each truck once more alone on its roads",
    advice="See where with fleetlog analyze density; try fewer trucks or a second way with fleetlog simulate "
    "--vary",
)  # fmt: skip
"""``share`` of the travel time, or of that on a stretch of lane where it varies."""

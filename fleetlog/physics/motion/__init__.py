"""One motion for all.

Path, curvature, heading, speed and acceleration of a log, with their uncertainty, at any rate.
"""

from fleetlog.physics.motion.noise import Noise
from fleetlog.physics.motion.reconstruction import Reconstruction, reconstruct
from fleetlog.physics.motion.rows import STANDING, measured_channels

__all__ = ["STANDING", "Noise", "Reconstruction", "measured_channels", "reconstruct"]

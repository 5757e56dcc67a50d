"""One motion for all: path, heading, speed and acceleration of a log, and how well they are known."""

from fleetlog.physics.motion.noise import Noise
from fleetlog.physics.motion.reconstruction import Reconstruction, reconstruct
from fleetlog.physics.motion.rows import STANDING, measured_channels

__all__ = ["STANDING", "Noise", "Reconstruction", "measured_channels", "reconstruct"]

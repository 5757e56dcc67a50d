"""MCAP recordings of Foxglove's and ROS 2's positions and batteries."""

from functools import partial

from fleetlog.importers._mcap_walk import MAGIC, McapWalk
from fleetlog.importers._topics import read_recording
from fleetlog.importers.base import Importer, holding

IMPORTER = Importer("mcap", (".mcap",), holding(MAGIC, first=len(MAGIC)), partial(read_recording, McapWalk))

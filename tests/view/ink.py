"""What the headless viewer has drawn: its views by name, and how much colour is in each."""

from __future__ import annotations

import io
import time
from typing import Any

import numpy as np

INK = 5e-4
"""Share of coloured points from which a view counts as drawn: frames, grids and axis texts are grey."""


def views(client: Any) -> dict[str, Any]:
    """Views by name."""
    return {v.name: v for v in client.get_state().views}


def is_drawn(client: Any, name: str) -> bool:
    """Whether a view gets ink within a while, as data arrive late."""
    client.take_screenshot()
    view = views(client)[name].view_id
    deadline = time.monotonic() + 15.0
    while colour_ink(bytes(client.take_screenshot(view))) <= INK:
        if time.monotonic() > deadline:
            return False
        time.sleep(0.2)
    return True


def colour_ink(png: bytes) -> float:
    """Share of the points of a PNG that are coloured, not grey."""
    from PIL import Image

    rgb = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int16)
    return float(((rgb.max(axis=2) - rgb.min(axis=2)) > 60).mean())

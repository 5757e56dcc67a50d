"""Colours, the same in recordings and pictures."""

import colorsys
from typing import Any

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]
Share = tuple[float, float, float]

# Okabe and Ito's colours, told apart by colour-blind people; blue is lightened and black left out for a dark
# ground.
_VEHICLES: tuple[Colour, ...] = (
    (86, 180, 233), (230, 159, 0), (0, 190, 140), (240, 228, 66), (204, 121, 167), (213, 94, 0),
    (90, 130, 255),
)  # fmt: skip

SOC_GOOD, SOC_LOW, SOC_EMPTY = (64, 196, 99), (245, 195, 50), (232, 65, 60)

ROAD, ROAD_EDGE, ARROW = (66, 74, 88), (120, 132, 150), (168, 180, 198)
ONE_WAY = (64, 86, 108)
BUILDING, BUILDING_EDGE = (150, 160, 178), (150, 160, 178)
COVERED, LIMITED = (120, 130, 190), (220, 170, 70)
PLACES: dict[str, Colour] = {
    "pick": (86, 180, 233), "drop": (204, 121, 167), "park": (165, 172, 182), "charge": (64, 196, 99),
}  # fmt: skip
CHARGING, RESERVED, WAITING = (110, 245, 140), (255, 176, 66), (132, 138, 150)
ACTIVITIES: dict[str, Colour] = {
    "drive_empty": (62, 116, 158), "drive_laden": (86, 180, 233), "wait": (232, 65, 60),
    "wait_place": (165, 70, 60), "pick": (240, 228, 66), "drop": (230, 159, 0), "charge": (64, 196, 99),
    "wait_charger": (204, 121, 167), "park": (74, 80, 92), "battery_empty": (140, 20, 30),
}  # fmt: skip
STAGES: dict[str, Colour] = {
    "waiting": WAITING, "being fetched": (62, 116, 158), "on the forks": (86, 180, 233),
}  # fmt: skip
CRITICAL, CALM = (232, 65, 60), (130, 190, 220)
RECORDED, SIMULATED = (230, 159, 0), (86, 180, 233)


def vehicle_colour(number: int) -> Colour:
    """Colour of the ``number``-th vehicle: seven well separated ones, then hues that never repeat exactly."""
    if number < len(_VEHICLES):
        return _VEHICLES[number]
    hue = (number * 0.618034) % 1.0
    r, g, b = colorsys.hls_to_rgb(hue, 0.55 + 0.12 * (number % 3 - 1), 0.7)
    return int(255 * r), int(255 * g), int(255 * b)


NAMED: dict[str, Colour] = {
    "recorded": (40, 44, 52), "measured": (40, 44, 52), "model before": (214, 120, 40),
    "model after": (31, 119, 180), "model": (31, 119, 180), "driving_laden": (31, 119, 180),
    "driving_empty": (140, 190, 225), "driving": (86, 150, 205), "handling": (240, 180, 50),
    "waiting": (214, 80, 60), "standing": (225, 150, 90), "charging": (64, 170, 90),
    "idle": (176, 182, 190), "no_data": (225, 228, 232),
}  # fmt: skip


def paper_colour(name: str, number: int) -> Share:
    """Of a curve or part on white paper, from 0 to 1: of its name, or darker of the ``number``-th vehicle."""
    r, g, b = NAMED.get(name) or (0.82 * c for c in vehicle_colour(number))
    return r / 255, g / 255, b / 255


def shade(colour: Colour, number: int) -> Colour:
    """One of seven shades of a colour, from darker to lighter."""
    factor = 0.7 + 0.07 * (number * 3 % 7)
    r, g, b = (min(255, int(c * factor)) for c in colour)
    return r, g, b


def soc_colours(soc: NDArray[Any]) -> NDArray[np.uint8]:
    """(N, 3) of states of charge (share): to 20 % red, to 50 % yellow, above green; grey where unknown."""
    colours = np.array([SOC_EMPTY, SOC_LOW, SOC_GOOD, (150, 150, 150)], np.uint8)
    return np.asarray(colours[np.digitize(soc, [0.2, 0.5, np.inf], right=True)])


def faded(colour: Colour, share: float, ground: Colour = (18, 20, 24)) -> Colour:
    """A colour mixed with the ground: all of it where ``share`` is 1."""
    r, g, b = (int(share * c + (1.0 - share) * d) for c, d in zip(colour, ground, strict=True))
    return r, g, b

"""A fit in words, as JSON and as a truck file."""

from typing import Any

import numpy as np

from fleetlog.calibrate.fit import CONFIDENCE, Blind, Combination, Estimate, Fit
from fleetlog.core.truck import truck_to_dict
from fleetlog.core.words import Sentences, listed

SAID = Sentences(__file__)
STRONG = 0.5  # Correlations from this on are worth a word


def blind_line(blind: Blind) -> str:
    """What the runs cannot tell, and which run would."""
    held, need = blind.held.words, f"add {blind.held.run}"
    if not blind.companions:
        return f"These runs say {'too little' if blind.weak else 'nothing'} about {held}: {need}."
    return f"These runs cannot tell {held} from {listed([u.words for u, _ in blind.companions])}: {need}."


def combination_words(combination: Combination) -> str:
    """As ``rolling coefficient / drive efficiency``."""
    out = combination.powers[0][0].words
    for u, power in combination.powers[1:]:
        size = "" if abs(abs(power) - 1.0) < 0.05 else f"^{abs(power):.2f}"
        out += f" {'*' if power > 0 else '/'} {u.words}{size}"
    return out


def estimate_line(e: Estimate) -> str:
    """One number of the truck, printed as fitted only where the runs carry it."""
    unit = e.unknown.in_file["unit"]
    said = f"{e.value if e.status == 'fitted' else e.prior:.4g}{'' if unit == '1' else f' {unit}'}"
    if e.status == "fitted":
        return f"{e.unknown.words}: {said} ({e.low:.4g} to {e.high:.4g}); was {e.prior:.4g}"
    kept = "kept at" if e.status == "held" else "not measured by itself; was"
    return f"{e.unknown.words}: {kept} {said}"


def lines(fit: Fit) -> list[str]:
    """The answer for the terminal."""
    seen = fit.observed
    rms = [np.sqrt(np.mean(((p - seen.measured) / seen.sigma) ** 2)) for p in (fit.before, fit.after)]
    out = [SAID("misses", figures=len(seen), rms=rms), SAID("fitted", confidence=CONFIDENCE)]
    fitted = [e for e in fit.estimates if e.status == "fitted"]
    out += [f"  {estimate_line(e)}" for e in fitted] or ["  none: these runs determine no single number"]
    out += [f"  {estimate_line(e)}" for e in fit.estimates if e.status != "fitted"]
    out += [*map(blind_line, fit.blind)]
    carried = ((combination_words(c), c.value, 1.96 * c.deviation) for c in fit.combinations)
    out += [SAID("determine", what=what, value=value, share=share) for what, value, share in carried]
    mine = [(k, e.unknown.words) for k, e in enumerate(fit.estimates) if e.status == "fitted"]
    pairs = [(b, a, float(fit.correlation[i, j])) for i, a in mine for j, b in mine if j < i]
    out += [f"{a} and {b} are correlated ({r:+.2f})." for a, b, r in pairs if abs(r) >= STRONG]
    if fit.spread_factor > 1.5:
        out.append(SAID("spread", fit=fit))
    return out


def summary(fit: Fit) -> dict[str, Any]:
    """JSON-ready; ``value`` and its interval are null for a number that the runs do not carry."""
    seen = fit.observed
    rows = zip(seen.labels, seen.measured, seen.sigma, fit.before, fit.after, strict=True)
    runs = [dict(zip(("run", "measured", "sigma", "before", "after"), row, strict=True)) for row in rows]
    keys, carried = [e.unknown.key for e in fit.estimates], ("value", "low", "high")
    return {
        "format_version": 1, "confidence": CONFIDENCE,
        "parameters": [{
            "key": e.unknown.key, "unit": e.unknown.in_file["unit"], "status": e.status, "prior": e.prior,
            **{name: getattr(e, name) if e.status == "fitted" else None for name in carried},
            "in_truck_file": e.value, "share_of_prior_variance": e.remaining,
        } for e in fit.estimates],
        "correlation": {"keys": keys, "matrix": fit.correlation},
        "not_identified": [{
            "parameter": b.held.key, "stands_in": [u.key for u, _ in b.companions], "needs": b.held.run,
            "statement": blind_line(b),
        } for b in fit.blind],
        "carried": [{
            "product": {u.key: power for u, power in c.powers}, "value": c.value,
            "relative_deviation": c.deviation,
        } for c in fit.combinations],
        "runs": runs if len(runs) <= 500 else len(runs),
        "spread_factor": fit.spread_factor,
    }  # fmt: skip


def truck_toml(fit: Fit) -> str:
    """The truck file; beside every number that calibration looked at, what became of it."""
    data = truck_to_dict(fit.truck)
    out = [f'name = "{data.pop("name")}"']
    notes = {e.unknown.key: f"  # {_note(e, fit)}" for e in fit.estimates}
    for section, values in data.items():
        numbers = (f"{k} = {float(v):.6g}{notes.get(f'{section}.{k}', '')}" for k, v in values.items())
        out += [f"[{section}]", *numbers]
    return "\n".join(out) + "\n"


def _note(e: Estimate, fit: Fit) -> str:
    if e.status == "fitted":
        return f"fitted: {e.low:.4g} to {e.high:.4g}"
    if e.status == "held":
        return "not carried by these runs: as in the truck file before"
    mine = (combination_words(c) for c in fit.combinations if c.powers[0][0] == e.unknown)
    return "".join(["goes with the held numbers", *(f"; measured is only {words}" for words in mine)])

"""Find where model and recording differ, and what physics the model leaves out."""

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fleetlog import engines
from fleetlog.api import inputs
from fleetlog.api.answer import Answer, destination
from fleetlog.api.inputs import DatasetLike, PathLike, SiteLike, TruckLike
from fleetlog.api.verb import verb
from fleetlog.core.arguments import Names, Seed
from fleetlog.errors import EXIT_DONE, EXIT_INPUT
from fleetlog.listening import notice, progress

if TYPE_CHECKING:
    from fleetlog.discovery.report.finding import Verdict


@verb(jobs=True)
def diagnose(
    dataset: DatasetLike, *, truck: TruckLike, site: SiteLike | None = None,
    against: DatasetLike | None = None, channels: Names = (), terms: Names = (),
    without: Names = (), holdout: Literal["trips", "vehicles", "days"] = "trips", gate: bool = False,
    seed: Seed = 0, output: PathLike | None = None, overwrite: bool = False,
) -> Answer:  # fmt: skip
    """Find where the recording DATASET and the model differ, and what physics the model leaves out.

    Writes diagnosis.json, model.toml with fields/, report.html and recording.rrd.

    Parameters
    ----------
    dataset : the recording.
    truck : truck file, or name of a preset: the nominal model.
    site : site or map in place of the one that the dataset was made with.
    against : simulated dataset to compare with, in place of the nominal model alone.
    channels : channels to judge, comma-separated: battery_power, soc, speed; all by default.
    terms : terms that may be named, comma-separated; all by default.
    without : columns to withhold, comma-separated (z, say); diagnose then looks for what they explain.
    holdout : what is held out of the search, and judges its result.
    gate : exit with 0 only if every channel was judged and nothing is missing.
    seed : seed of the cross-validation splits.
    output : folder to write.
    """
    from fleetlog.discovery import diagnose as discovery
    from fleetlog.discovery.report.output import as_result, write_diagnosis

    def write(folder: Path) -> None:
        from fleetlog.report.diagnosis import diagnosis_page
        from fleetlog.view.results import write_result_recording

        write_diagnosis(found, folder)
        (folder / "report.html").write_text(diagnosis_page(found, told, place, recording), encoding="utf-8")
        write_result_recording(told, place, folder / "recording.rrd")

    discovery.check(channels=channels, terms=terms, without=without)
    recording, nominal = inputs.as_dataset(dataset), inputs.as_truck(truck)
    given = None if site is None else inputs.as_site(site)
    simulated = None if against is None else inputs.as_dataset(against)
    engines.current().ahead = () if output is None else engines.loading("rerun", "matplotlib.figure")
    with destination(output, "diagnosis", overwrite, (dataset, truck, site, against)) as keep:
        found = discovery.diagnose(
            recording, nominal, site=given, against=simulated, channels=channels, terms=terms,
            without=without, holdout=holdout, seed=seed, progress=lambda step: progress(step, 0.0),
        )  # fmt: skip
        place = given or recording.site
        shut = [f"{name} could not be judged" for name in unjudged(found.verdict, channels)]
        shut += [] if found.verdict.passes or shut else ["recording and model differ"]
        if gate and shut:
            notice(f"the gate stays shut: {', '.join(shut)}")
        status = EXIT_INPUT if gate and shut else EXIT_DONE
        told = as_result(found)
        return keep(Answer.of(told, place, value=found, write=write, status=status))


def unjudged(verdict: "Verdict", wanted: Collection[str]) -> list[str]:
    """Return the channels that the recording has or the user wants, and that lack a figure."""
    judged = {c.name for c in verdict.channels if c.judged}
    return [n for n in dict.fromkeys([*(c.name for c in verdict.channels), *wanted]) if n not in judged]

"""Learn roads, places and zones from traces alone."""

from pathlib import Path
from typing import Annotated

from fleetlog.api.answer import Answer, destination
from fleetlog.api.inputs import DatasetLike, PathLike, SiteLike, as_dataset, as_site
from fleetlog.api.verb import verb
from fleetlog.core.arguments import Between

Passes = Annotated[int, Between(1, 1_000_000, whole=True)]


@verb()
def learn(
    dataset: DatasetLike, *, site: SiteLike | None = None, lane: Annotated[float, Between(0.5, 20.0)] = 2.3,
    spur: Annotated[float, Between(0.0, 200.0)] = 7.0, min_passes: Passes = 1, min_visits: Passes = 3,
    output: PathLike | None = None, overwrite: bool = False,
) -> Answer:  # fmt: skip
    """Learn the site of DATASET from its traces alone: roads, places and zones, each with its evidence.

    Parameters
    ----------
    site : an existing site or map: propose the roads and directions that it lacks.
    lane : opposite directions closer than this are one road [m].
    spur : a shorter dead end leads into a bay and is no road [m].
    min_passes : leave out roads driven less often.
    min_visits : leave out places visited less often.
    output : folder of the site."""
    from fleetlog.learn.learn import learn as learned
    from fleetlog.learn.learn import write_learned
    from fleetlog.learn.roads import Settings
    from fleetlog.view.picture import write_picture

    def write(folder: Path) -> None:
        write_learned(found, result, folder)
        write_picture(result, found, folder / "learn.png")

    settings = Settings(lane, spur, min_passes)
    with destination(output, "site", overwrite, (dataset, site)) as keep:
        known = None if site is None else as_site(site)
        found, result = learned(as_dataset(dataset), site=known, settings=settings, min_visits=min_visits)
        return keep(Answer.of(result, found, kind="site", value=found, write=write))

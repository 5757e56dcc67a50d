"""Describe a dataset, log, map, site, truck or recording, or a folder that fleetlog wrote."""

from fleetlog.api.answer import Answer
from fleetlog.api.inputs import existing
from fleetlog.api.kinds import DatasetLike
from fleetlog.api.verb import verb
from fleetlog.errors import EXIT_DAMAGED, EXIT_DONE


@verb()
def info(path: DatasetLike) -> Answer:
    """Describe PATH: a dataset, log, map, site, truck or recording, or a folder that fleetlog wrote.

    Parameters
    ----------
    path : what is to be described.

    Examples
    --------
    >>> import fleetlog
    >>> print(str(fleetlog.info("sample/roads.geojson")).splitlines()[2])
      network   76 directed edges (4 one-way), 27 nodes, 1.35 km
    """
    from fleetlog.verbs._describe import describe

    summary, lines = describe(existing(path))
    status = EXIT_DAMAGED if summary.get("damage") or summary.get("rejected") else EXIT_DONE
    return Answer("info", summary, lines=lines, status=status)

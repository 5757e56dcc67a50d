"""A learned site as files."""

from pathlib import Path

from fleetlog.learn.learn import Learned
from fleetlog.store.results import write_result
from fleetlog.store.site_files import write_site


def write_learned(found: Learned, folder: Path) -> None:
    """Write ``site.toml``, ``roads.geojson`` with every road's evidence, and the tables into ``folder``."""
    evidence = {
        str(row.edge_id): {"passes": row.passes, "trucks": row.trucks, "days": row.days}
        for row in found.roads.itertuples()
    }
    write_site(found.site, folder, evidence)
    write_result(found.result, folder, found.site.frame)

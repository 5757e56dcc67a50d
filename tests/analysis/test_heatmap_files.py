"""The files of a heat map, read by others: GeoTIFF by rasterio, GeoParquet by geopandas."""

import json
import math

import numpy as np
import pytest

from fleetlog.analysis.heatmap import heatmap
from fleetlog.core.result import Grid
from fleetlog.core.site import Frame
from fleetlog.store.results import transformation, write_geotiff, write_result

VALUES = np.array([[1.0, 2.0, 3.0], [4.0, np.nan, 6.0]])
GRID = Grid("heat", VALUES, 10.0, 20.0, 2.0, "time [s/m²]")


@pytest.mark.parametrize("rotation", [0.0, 0.3, -2.0])
def test_a_raster_lies_where_it_should(tmp_path, rotation):
    """A cell's centre through the file's own transformation and system is its place through the site's frame."""
    rasterio = pytest.importorskip("rasterio")
    pyproj = pytest.importorskip("pyproj")
    frame = Frame(49.9769, 9.1513, rotation)
    write_geotiff(GRID, tmp_path / "g.tif", frame)
    with rasterio.open(tmp_path / "g.tif") as f:
        assert np.array_equal(f.read(1), VALUES[::-1].astype("f4"), equal_nan=True)
        assert math.isnan(f.nodata) and f.count == 1
        east, north = f.transform @ (2.5, 0.5)  # the north-eastern cell: column 2, row 0 from the top
        to_earth = pyproj.Transformer.from_crs(f.crs.to_wkt(), "EPSG:4326", always_xy=True)
        longitude, latitude = to_earth.transform(east, north)
    expected = frame.to_geographic([15.0], [23.0])
    assert latitude == pytest.approx(expected[0][0], abs=1e-9)
    assert longitude == pytest.approx(expected[1][0], abs=1e-9)


def test_a_mask_is_the_second_band(tmp_path):
    rasterio = pytest.importorskip("rasterio")
    mask = np.isfinite(VALUES)
    write_geotiff(Grid("d", VALUES, 0, 0, 1.0, "x", True, mask), tmp_path / "g.tif")
    with rasterio.open(tmp_path / "g.tif") as f:
        assert f.count == 2 and np.array_equal(f.read(2), mask[::-1])


def test_pillow_reads_it_too(tmp_path):
    image = pytest.importorskip("PIL.Image")
    write_geotiff(GRID, tmp_path / "g.tif")
    assert np.array_equal(
        np.asarray(image.open(tmp_path / "g.tif")), VALUES[::-1].astype("f4"), equal_nan=True
    )


def test_corners_of_the_transformation():
    m = transformation(GRID)
    assert m @ [0, 2, 1] == pytest.approx([10.0, 20.0]) and m @ [3, 0, 1] == pytest.approx([16.0, 24.0])


def test_cells_are_squares_on_the_earth(fleet, tmp_path):
    r = heatmap(fleet, cell=2.0)
    write_result(r, tmp_path, fleet.site.frame)
    assert (tmp_path / "heat.tif").is_file()
    features = json.loads((tmp_path / "cells.geojson").read_text())["features"]
    ring = np.array(features[0]["geometry"]["coordinates"][0])
    x, y = fleet.site.frame.to_local(ring[:, 1], ring[:, 0])
    row = r.tables["cells"].iloc[0]
    assert np.ptp(x) == pytest.approx(2.0, abs=0.01) and np.mean([x.min(), x.max()]) == pytest.approx(
        row.x, abs=0.01
    )
    area = np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) / 2
    assert area == pytest.approx(4.0, abs=0.02)  # positive: counter-clockwise, as RFC 7946 asks
    geopandas = pytest.importorskip("geopandas")
    g = geopandas.read_parquet(tmp_path / "cells.parquet")
    assert len(g) == len(features) and g.crs.to_epsg() in (4326, None) and g.is_valid.all()
    assert g.geometry.iloc[0].exterior.coords[0] == pytest.approx(tuple(ring[0]), abs=1e-7)
    assert g.time.sum() == pytest.approx(r.tables["cells"].time.sum())
    write_result(r, tmp_path, None)
    assert geopandas.read_parquet(tmp_path / "cells.parquet").crs is None

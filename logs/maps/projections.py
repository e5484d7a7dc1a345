"""Projects latitude and longitude (WGS 84, degrees) to plane coordinates (m, x east, y north), as
map makers do.

Transverse Mercator of scale k about a central meridian (Krueger's series to n^4, below 1 um within
a UTM zone; Karney, J. Geodesy 85, 2011, equations 7 to 12 and 35), phi latitude, lam longitude from
the meridian, n third flattening:

(1) tau = tan phi,  sigma = sinh(e atanh(e tau / sqrt(1 + tau^2))),
    tau' = tau sqrt(1 + sigma^2) - sigma sqrt(1 + tau^2)
(2) xi' = atan2(tau', cos lam),  eta' = asinh(sin lam / sqrt(tau'^2 + cos^2 lam))
(3) y + i x = k A (zeta + sum_j alpha_j sin(2 j zeta)),  zeta = xi' + i eta',
        A = a / (1 + n) (1 + n^2 / 4 + n^4 / 64)
(4) UTM: k = 0.9996, meridian in the middle of the zone,
        500 km added to x (and 10,000 km to y in the south)
(5) MGRS: UTM from the south-west corner of a square of 100 km, whose two letters repeat every 18
    degrees of longitude and every 2,000 km to the north (the letters of WGS 84 grids: DMA TM
    8358.1)
(6) tangent plane: east and north axes of a Cartesian frame at the place, on the ellipsoid

Names in files: Lanelet2's and Autoware Mini's UTM with origin and Autoware's LocalCartesianUTM are
"utm LAT, LON"; Autoware's MGRS is the square's name; CARLA's towns are "tmerc 0, 0".
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import LogError

A_M, F = 6_378_137.0, 1.0 / 298.257223563
"""WGS 84: semi-major axis and flattening."""
UTM_SCALE = 0.9996
SQUARE_M = 1e5
_N = F / (2.0 - F)
_E2 = F * (2.0 - F)
_RADIUS = A_M / (1.0 + _N) * (1.0 + _N**2 / 4.0 + _N**4 / 64.0)
_ALPHA = (
    _N / 2.0 - 2.0 * _N**2 / 3.0 + 5.0 * _N**3 / 16.0 + 41.0 * _N**4 / 180.0,
    13.0 * _N**2 / 48.0 - 3.0 * _N**3 / 5.0 + 557.0 * _N**4 / 1440.0,
    61.0 * _N**3 / 240.0 - 103.0 * _N**4 / 140.0,
    49561.0 * _N**4 / 161280.0,
)
_COLUMNS = ("ABCDEFGH", "JKLMNPQR", "STUVWXYZ")
_ROWS = "ABCDEFGHJKLMNPQRSTUV"
FORMS = (
    '"LAT, LON" or "utm LAT, LON", "tmerc LAT, LON", "enu LAT, LON", "utm", or an MGRS square '
    'such as "54SUE"'
)

Plane = Callable[[FloatArray], FloatArray]
"""Latitudes and longitudes `(n, 2)`, degrees -> x and y `(n, 2)`, m."""


def mercator(points: FloatArray, meridian: float, scale: float) -> FloatArray:
    """Project points `(n, 2)`, degrees, by transverse Mercator (1) to (3): x from the meridian, y
    from the equator.
    """
    phi, lam = np.radians(points[:, 0]), np.radians(points[:, 1] - meridian)
    e, tau = sqrt(_E2), np.tan(phi)
    sigma = np.sinh(e * np.arctanh(e * tau / np.hypot(1.0, tau)))
    conformal = tau * np.hypot(1.0, sigma) - sigma * np.hypot(1.0, tau)
    zeta = np.arctan2(conformal, np.cos(lam)) + 1j * np.arcsinh(
        np.sin(lam) / np.hypot(conformal, np.cos(lam))
    )
    zeta = zeta + sum(alpha * np.sin(2.0 * j * zeta) for j, alpha in enumerate(_ALPHA, start=1))
    return np.column_stack([zeta.imag, zeta.real]) * (scale * _RADIUS)


def utm_zone(lat: float, lon: float) -> int:
    """Return the UTM zone of a place, with the exceptions of Norway and Svalbard."""
    zone = int((lon + 180.0) // 6.0) % 60 + 1
    if 56.0 <= lat < 64.0 and 3.0 <= lon < 12.0:
        return 32
    if 72.0 <= lat < 84.0 and 0.0 <= lon < 42.0:
        return 31 + 2 * int((lon + 3.0) // 12.0)
    return zone


def utm(points: FloatArray, zone: int, *, north: bool) -> FloatArray:
    """Return UTM coordinates (4) of points `(n, 2)` in one zone, m."""
    return mercator(points, 6.0 * zone - 183.0, UTM_SCALE) + np.array([5e5, 0.0 if north else 1e7])


def tangent(points: FloatArray, lat: float, lon: float) -> FloatArray:
    """Return east and north (6) of points `(n, 2)` relative to a place, m."""
    east, north = np.radians(lon), np.radians(lat)
    offset = _geocentric(points) - _geocentric(np.array([[lat, lon]]))
    rows = [
        [-np.sin(east), np.cos(east), 0.0],
        [-np.sin(north) * np.cos(east), -np.sin(north) * np.sin(east), np.cos(north)],
    ]
    return np.asarray(offset @ np.array(rows).T)


def _geocentric(points: FloatArray) -> FloatArray:
    phi, lam = np.radians(points).T
    normal = A_M / np.sqrt(1.0 - _E2 * np.sin(phi) ** 2)
    ring = normal * np.cos(phi)
    return np.column_stack(
        [ring * np.cos(lam), ring * np.sin(lam), normal * (1.0 - _E2) * np.sin(phi)]
    )


@dataclass(frozen=True)
class Projection:
    """The projection of a map's latitudes and longitudes to plane coordinates."""

    kind: str  # "utm", "tmerc" or "enu", each relative to the origin; or "mgrs"
    # latitude and longitude, degrees; None: that of the first point, and "utm" is not shifted
    origin: tuple[float, float] | None = None
    square: str = ""  # square of "mgrs" ("54SUE"); "": that of the map's first point
    scale: float = 1.0  # scale of "tmerc" along its meridian

    def __str__(self) -> str:
        place = "" if self.origin is None else f" {self.origin[0]:.10g}, {self.origin[1]:.10g}"
        return f"{self.kind}{place}{' ' * bool(self.square)}{self.square}"

    def __call__(self, points: FloatArray) -> FloatArray:
        """Project latitudes and longitudes `(n, 2)`, degrees, to plane points `(n, 2)`, m."""
        first = (
            self.origin if self.origin is not None else (float(points[0, 0]), float(points[0, 1]))
        )
        zero = np.array([first])
        if self.kind == "enu":
            return tangent(points, *first)
        if self.kind == "tmerc":
            return mercator(points, first[1], self.scale) - mercator(zero, first[1], self.scale)
        zone = int(self.square[:-3]) if self.square else utm_zone(*first)
        north = self.square[-3] >= "N" if self.square else first[0] >= 0.0
        plane = utm(points, zone, north=north)
        if self.kind != "mgrs":
            return plane - utm(zero, zone, north=north) if self.origin is not None else plane
        # (5), of the square that holds the first point
        corner = SQUARE_M * np.floor(plane[0] / SQUARE_M)
        if self.square:
            row = _ROWS.index(self.square[-1]) - (5 if zone % 2 == 0 else 0)
            cycles = round((float(corner[1]) / SQUARE_M - row) / len(_ROWS))
            east = 1 + _COLUMNS[(zone - 1) % 3].index(self.square[-2])
            corner = SQUARE_M * np.array([east, row + cycles * len(_ROWS)])
        return plane - corner


_PLACE = re.compile(r"(?:(utm|tmerc|enu)\s+)?(-?\d+(?:\.\d*)?)\s*,\s*(-?\d+(?:\.\d*)?)")
_SQUARE = re.compile(r"(\d{1,2})([C-HJ-NP-X])([A-HJ-NP-Z])([A-HJ-NP-V])")


def parse_projection(text: str) -> Projection:
    """Parse the name of a projection (`FORMS`); LogError if it is none."""
    text = text.strip()
    place, square = _PLACE.fullmatch(text), _SQUARE.fullmatch(text.upper())
    if text in ("utm", "mgrs"):
        return Projection(text)
    if place is not None:
        name, latitude, longitude = place.groups()
        return Projection(name or "utm", check_on_earth(float(latitude), float(longitude)))
    if square is not None:
        zone, _, column, *_ = square.groups()
        if 1 <= int(zone) <= 60 and column in _COLUMNS[(int(zone) - 1) % 3]:
            return Projection("mgrs", square=square[0])
    raise LogError(f"no map origin: {text!r}", topic="[log] map_origin", remedy=f"give {FORMS}")


def check_on_earth(lat: float, lon: float) -> tuple[float, float]:
    """Return latitude and longitude, degrees; LogError if they are out of range."""
    if not (abs(lat) <= 90.0 and abs(lon) <= 360.0):
        raise LogError(f"no place on earth: latitude {lat}, longitude {lon}", remedy="give degrees")
    return lat, lon

"""WGS-84 against published values, closed forms and the geometry of the ellipsoid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numeric import EPS, assert_derivatives

from jaxalign import earth, wgs84
from jaxalign.earth import Site
from jaxalign.vector import Vec3

A, F = 6378137.0, 1 / 298.257223563  # NIMA TR8350.2, table 3.1
B, E2 = A * (1 - F), F * (2 - F)
RATE = 7.292115e-5
LATITUDES = np.deg2rad([-89.0, -45.0, -1.0, 0.0, 30.0, 60.0, 89.9])
gravity, radii, rate = jax.jit(earth.normal_gravity), jax.jit(earth.radii), jax.jit(earth.earth_rate)
transport = jax.jit(earth.transport_rate)


@pytest.mark.parametrize(
    ("lat_deg", "published"),
    [(0.0, 9.7803253359), (90.0, 9.8321849379), (-90.0, 9.8321849379), (45.0, 9.80619777)],
)
def test_normal_gravity_as_published(lat_deg, published):
    """Equator and poles: NIMA TR8350.2, table 3.4 (9.8321849378 there, rounded down)."""
    assert float(gravity(np.deg2rad(lat_deg), 0.0)) == pytest.approx(published, abs=1e-8 if lat_deg == 45 else 1.5e-10)


def test_normal_gravity_is_somigliana_with_both_axes():
    """The textbook form with the gravity at equator and pole."""
    cos2, sin2 = np.cos(LATITUDES) ** 2, np.sin(LATITUDES) ** 2
    textbook = (A * 9.7803253359 * cos2 + B * 9.8321849378 * sin2) / np.sqrt(A**2 * cos2 + B**2 * sin2)
    np.testing.assert_allclose(gravity(LATITUDES, 0.0), textbook, rtol=0, atol=2e-10)


def test_free_air_gradient():
    """-3.086e-6 1/s^2 at mid latitude, and everywhere the formula of Bruns to first order in the flattening."""
    slope = jax.jit(jax.vmap(jax.grad(earth.normal_gravity, argnums=1)))
    zero = np.zeros_like(LATITUDES)
    assert float(slope(np.array([np.pi / 4]), np.zeros(1))[0]) == pytest.approx(-3.086e-6, abs=1e-9)
    x = 1 - E2 * np.sin(LATITUDES) ** 2
    curvature = np.sqrt(x) / A + x**1.5 / (A * (1 - E2))
    bruns = -np.asarray(gravity(LATITUDES, 0.0)) * curvature - 2 * RATE**2
    np.testing.assert_allclose(slope(LATITUDES, zero), bruns, rtol=5 * F**2)


def test_gravity_falls_with_the_square_of_the_distance():
    """At 10 km the second order in h / a is that of an inverse square, up to the flattening and the third order."""
    lat, h = 0.7, np.array([-10e3, 10e3])
    g0, (below, above) = gravity(lat, 0.0), gravity(lat, h)
    second = (below + above - 2 * g0) / g0 / (h[1] / A) ** 2
    assert float(second) == pytest.approx(6.0, abs=0.05)


def test_site_adds_its_anomaly():
    site = Site(0.5, 2.0, 100.0, anomaly=3e-4)
    assert float(site.gravity - gravity(0.5, 100.0)) == pytest.approx(3e-4, abs=4e-15)
    assert float(Site(0.5).gravity) == pytest.approx(float(gravity(0.5, 0.0)), rel=2 * EPS)
    for leaf in jax.tree.leaves(Site(1)):
        assert leaf.dtype == jnp.float64
        assert not leaf.weak_type


def test_radii_at_equator_and_pole():
    meridian, prime_vertical = radii(np.array([0.0, np.pi / 2, -np.pi / 2]))
    polar = A / np.sqrt(1 - E2)
    np.testing.assert_allclose(meridian, [A * (1 - E2), polar, polar], rtol=1e-11)
    np.testing.assert_allclose(prime_vertical, [A, polar, polar], rtol=1e-11)
    assert polar == pytest.approx(A**2 / B, rel=1e-15)
    assert pytest.approx(E2, abs=5e-15) == wgs84.ECCENTRICITY2
    assert earth.SEMI_MAJOR_AXIS == A


def test_earth_rate():
    w = rate(LATITUDES)
    np.testing.assert_allclose(w.norm(), RATE, rtol=4 * EPS)
    np.testing.assert_allclose(w.z, RATE * np.sin(LATITUDES), rtol=4 * EPS)
    np.testing.assert_array_equal(w.x, 0.0)
    assert np.all(w.y > 0)  # northwards on both hemispheres


def _ecef(lat, lon, h):
    n = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    return np.array(
        [(n + h) * np.cos(lat) * np.cos(lon), (n + h) * np.cos(lat) * np.sin(lon), (n * (1 - E2) + h) * np.sin(lat)]
    )


def _axes(lat, lon):
    """East, north and up as the columns of C_en."""
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    return np.stack([east, np.cross(up, east), up], axis=1)


def _geodetic(position):
    lon, p = np.arctan2(position[1], position[0]), np.hypot(position[0], position[1])
    lat = np.arctan2(position[2], p * (1 - E2))
    for _ in range(20):  # each pass gains a factor of 1 / E2
        lat = np.arctan2(position[2] + E2 * A / np.sqrt(1 - E2 * np.sin(lat) ** 2) * np.sin(lat), p)
    return lat, lon


@pytest.mark.parametrize("lat", np.deg2rad([-80.0, -30.0, 0.0, 45.0, 85.0]))
@pytest.mark.parametrize("velocity", [(10.0, 0.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, 10.0), (3.0, -7.0, 2.0)])
def test_transport_rate_is_how_the_axes_turn_over_the_ellipsoid(lat, velocity):
    """Move in a straight line through the point and turn the axes with it: C_en' = C_en [w_en x]."""
    lon, h, dt = 0.4, 2000.0, 5.0
    here, step = _ecef(lat, lon, h), _axes(lat, lon) @ np.array(velocity) * dt
    ahead, behind = (_axes(*_geodetic(here + sign * step)) for sign in (1, -1))
    turned = _axes(lat, lon).T @ (ahead - behind) / (2 * dt)
    expected = [turned[2, 1], turned[0, 2], turned[1, 0]]
    found = transport(lat, h, Vec3(*velocity)).array
    # the axes are good to eps; the step of 50 m is (50 / R cos(lat))^2 of a curve
    np.testing.assert_allclose(found, expected, rtol=0, atol=10 * EPS / dt + 1e-8 * np.linalg.norm(expected))


def test_derivatives_with_latitude():
    def everything(x):
        lat, h, east, north = x
        w = earth.transport_rate(lat, h * 1e4, Vec3(east, north, 0.0)) * 1e6
        return jnp.stack([earth.normal_gravity(lat, h * 1e4), *(earth.earth_rate(lat) * 1e4).array, *w.array])

    points = np.array([[lat, 0.3, 2.0, -3.0] for lat in (-1.0, 0.0, 0.8)])
    jacobians = assert_derivatives(everything, points, third=40.0)
    lat = points[:, 0]
    np.testing.assert_allclose(jacobians[:, 2, 0], -RATE * 1e4 * np.sin(lat), rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(jacobians[:, 3, 0], RATE * 1e4 * np.cos(lat), rtol=1e-12)
    assert jacobians[1, 0, 0] == 0  # gravity is even in latitude

"""FIR cascade, wavelet, spectrum, objectives, and filters in front of an alignment."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from jaxalign import UserError, align, epochs_from_log, with_parameters
from jaxalign.inertial_unit import ImuErrors
from jaxalign.methods import build
from jaxalign.metrics import attitude_error_deg
from jaxalign.prefilter import PREFILTERS, Fir, Vondrak, Wavelet, filtered_force, misfit, multitaper, vondrak
from jaxalign.published.objectives import changes_db, printed, reconstructed
from jaxalign.simulate import Scenario, SineForce, scenario, simulate

DT = 0.005


compiled = jax.jit(lambda prefilter, y, dt: prefilter(y, dt), static_argnums=2)


def through(prefilter, y, dt=DT):
    return np.asarray(compiled(prefilter, np.asarray(y)[:, None], dt))[:, 0]


def measured_gain(prefilter, frequency, n=40000):
    """Amplitude in the middle of a long record, by least squares."""
    t = np.arange(n) * DT
    middle = slice(2 * n // 5, 3 * n // 5)
    out = through(prefilter, np.sin(2 * np.pi * frequency * t))[middle]
    angle = 2 * np.pi * frequency * t[middle]
    return np.linalg.lstsq(np.stack([np.sin(angle), np.cos(angle)], axis=1), out, rcond=None)[0]


@pytest.mark.parametrize("frequency", [0.05, 0.3, 0.5, 1.0, 5.0])
def test_fir_response(frequency):
    np.testing.assert_allclose(measured_gain(Fir(), frequency), [float(Fir().response(frequency, DT)), 0.0], atol=1e-6)


def test_fir_is_a_low_pass_of_the_stated_shape():
    f = np.array([0.0, 0.2, 0.5, 1.0, 7.5, 8.0, 20.0, 40.0, 99.0])
    gain = np.asarray(Fir().response(f, DT))
    assert gain[0] == pytest.approx(1.0, abs=1e-14)
    assert gain[1] == pytest.approx(1.0, abs=0.02)
    assert gain[2] == pytest.approx(0.46, abs=0.005)
    assert (np.abs(gain[3:]) < 2e-3).all()


@pytest.mark.parametrize(
    ("dt", "factors"), [pytest.param(0.005, (5, 5), marks=pytest.mark.slow), (0.01, (5, 2)), (0.02, (5,)), (0.125, ())]
)
def test_fir_decimates_by_the_rate(dt, factors):
    assert Fir().factors(dt) == factors
    for n in (1, 7, 300, 4001) if dt == DT else (7, 4001):  # gravity passes exactly, whatever the length
        np.testing.assert_allclose(through(Fir(), np.full(n, 9.8), dt), 9.8, rtol=1e-14)


def test_fir_against_the_same_filter_in_one_piece():
    """No decimation: scipy's direct convolution of the mirrored record."""
    y = np.random.default_rng(1).normal(size=500)
    taps = scipy.signal.firwin(65, 0.5, window="hamming", fs=8.0)
    extended = np.pad(y, 32, mode="reflect")
    np.testing.assert_allclose(through(Fir(), y, 0.125), np.convolve(extended, taps, "valid"), atol=1e-12)


def test_fir_ends_are_even():
    """A noisy end sample is not doubled: the ends stay within the record's own range."""
    y = np.zeros(4000)
    y[0] = y[-1] = 1.0
    assert np.abs(through(Fir(), y)).max() < 0.02


def test_wavelet_is_the_approximation():
    pywt = pytest.importorskip("pywt")
    y = np.random.default_rng(2).normal(size=5000)
    parts = pywt.wavedec(y, "db4", mode="symmetric", level=8)
    low = pywt.waverec([parts[0]] + [None] * 8, "db4", mode="symmetric")[:5000]
    np.testing.assert_allclose(through(Wavelet(), y), low, atol=1e-12)
    assert (Wavelet().level(0.005), Wavelet().level(0.01), Wavelet().level(1.0)) == (8, 7, 0)
    np.testing.assert_array_equal(through(Wavelet(), y, 1.0), y)
    columns = jnp.asarray(y.reshape(2500, 2))
    together = jax.jit(jax.vmap(lambda x: Wavelet(cutoff=2.0)(x, DT)))(jnp.stack([columns, -columns]))
    np.testing.assert_allclose(together[1], -Wavelet(cutoff=2.0)(columns, DT), atol=1e-12)


@pytest.mark.parametrize("frequency", [0.02, 0.1, 0.3, 1.0])
def test_wavelet_response(frequency):
    """Averaged over the phase, as it says."""
    pytest.importorskip("pywt")
    gain = measured_gain(Wavelet(), frequency)[0]
    assert gain == pytest.approx(float(Wavelet().response(frequency, DT)), abs=5e-3)


def test_vondrak_response_is_the_formula():
    np.testing.assert_allclose(measured_gain(Vondrak(), 0.7), [float(Vondrak().response(0.7, DT)), 0.0], atol=1e-6)


@pytest.mark.parametrize("condition", [2, *(pytest.param(c, marks=pytest.mark.slow) for c in (1, 3, 4))])
def test_frozen_spectra_and_objectives(shared, condition):
    with np.load(shared / "cases" / "disturbed_psd.npz") as z:
        x, s, table, columns = z[f"x_c{condition}"], z[f"S_c{condition}"], z[f"table_c{condition}"], str(z["columns"])
        assert (float(z["NW"]), int(z["K"]), float(z["fs"]), float(z["fsplit"])) == (4.0, 7, 200.0, 0.5)
    f, before = multitaper(x, DT)
    np.testing.assert_allclose(before[:400], s, rtol=1e-9)
    smoothed = jax.jit(jax.vmap(lambda theta: vondrak(np.arange(len(x)) * DT, x, theta=theta)))(table[:, 1])
    for y, row in zip(smoothed, table, strict=True):
        expected = dict(zip(columns.split(","), row, strict=True))
        low, high = changes_db(f, before, multitaper(y, DT)[1])
        assert abs(low - expected["dL_dB"]) < 1e-3
        assert abs(high - expected["dH_dB"]) < 0.1
        np.testing.assert_allclose(printed(low, high)[0], expected["phi_P"], rtol=1e-6)
        np.testing.assert_allclose(reconstructed(low, high)[0], expected["phi_B"], rtol=1e-6)


def test_spectrum_of_known_processes():
    """White noise has its density, a sine its power; the sum is the variance."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(50, 12000)) * 0.3
    f, density = multitaper(x, DT)
    assert float(jnp.mean(density[:, 1:-1])) == pytest.approx(0.09 * 2 * DT, rel=0.01)
    np.testing.assert_allclose(jnp.sum(density, -1) * f[1], x.var(axis=1), rtol=0.02)
    t = np.arange(12000) * DT
    f, density = multitaper(2.0 * np.sin(2 * np.pi * 3 * t), DT)
    near = np.abs(f - 3) < 0.1
    assert float(jnp.sum(density[near]) * f[1]) == pytest.approx(2.0, rel=2e-3)
    f, density = multitaper(x[:, :4001], DT)
    np.testing.assert_allclose(jnp.sum(density, -1) * f[1], x[:, :4001].var(axis=1), rtol=0.03)


def test_objectives_have_guarded_domains_and_true_derivatives():
    for objective in (printed, reconstructed):
        value, ok = objective(0.5, 0.9)
        assert not ok
        assert value == 0
        slopes = jax.grad(lambda x, f=objective: f(x[0], x[1])[0])(jnp.array([0.5, 0.9]))
        assert (np.asarray(slopes) == 0).all()
        at = jnp.array([0.3, 20.0])
        slopes = jax.grad(lambda x, f=objective: f(x[0], x[1])[0])(at)
        for h in (1e-3, 1e-4):
            moves = np.eye(2) * h
            numeric = [(objective(*(at + m))[0] - objective(*(at - m))[0]) / (2 * h) for m in moves]
            np.testing.assert_allclose(slopes, numeric, rtol=1e-4)
    assert float(printed(2.0, 50.0)[0]) > 1.0  # degenerate: beyond its limit
    assert 0.99 < float(reconstructed(0.0, 50.0)[0]) < 1.0


@pytest.mark.parametrize("condition", [1, 2, 3, 4])
def test_misfit_has_its_minimum_at_the_split(shared, condition):
    """One minimum over four decades, near 0.5 Hz (disturbed.md: 0.47 to 0.50), its gradient true at two step sizes."""
    with np.load(shared / "cases" / "disturbed_psd.npz") as z:
        f, s = multitaper(z[f"x_c{condition}"], DT)

    def j(log_cutoff):
        return misfit(f, s, Vondrak(cutoff=jnp.exp(log_cutoff)).response(f, DT))

    cutoffs = np.geomspace(0.01, 100, 161)
    values = np.asarray(jax.jit(jax.vmap(j))(np.log(cutoffs)))
    best = cutoffs[values.argmin()]
    assert 0.45 < best < 0.52
    falling = np.diff(values) < 0
    assert (np.diff(falling.astype(int)) != 0).sum() == 1
    slope = float(jax.grad(j)(jnp.log(0.3)))
    for h in (1e-3, 1e-4):
        assert slope == pytest.approx(float(j(jnp.log(0.3) + h) - j(jnp.log(0.3) - h)) / (2 * h), rel=1e-4)


@pytest.mark.slow
def test_objectives_differentiate_through_the_filter(shared):
    """(27) both ways over ln(cut-off), filter and spectrum in the loop, against differences at two step sizes."""
    with np.load(shared / "cases" / "disturbed_psd.npz") as z:
        x = z["x_c2"][:4000]
    t = np.arange(len(x)) * DT
    f, before = multitaper(x, DT)

    def both(log_cutoff):
        low, high = changes_db(f, before, multitaper(vondrak(t, x, jnp.exp(log_cutoff)), DT)[1])
        return jnp.stack([jnp.log(printed(low, high)[0]), reconstructed(low, high)[0]])

    value, at = jax.jit(both), float(np.log(0.8))
    forward, reverse = jax.jit(jax.jacfwd(both))(at), jax.jit(jax.jacrev(both))(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-7)
    for h in (1e-3, 1e-4):
        np.testing.assert_allclose(forward, (value(at + h) - value(at - h)) / (2 * h), rtol=1e-4)


def shaken(**options) -> Scenario:
    """A rocking base (10 deg sway) whose force is shaken by 10 mg as well."""
    made = scenario("sway", duration=100.0)
    return dataclasses.replace(
        made,
        imu=ImuErrors(made.imu.gyro),
        force=SineForce.of_mg(10.0, frequency=(3.3, 11.1)),
        name="rocking",
        **options,
    )


@pytest.mark.slow
def test_a_rocking_base_is_filtered_in_the_inertial_frame():
    """In b the filter takes some of gravity's turning for a disturbance; in b0 only the disturbance goes."""
    clean = simulate(dataclasses.replace(shaken(), force=None), seed=1)
    log = simulate(shaken(), seed=1)
    left = {}
    for frame in ("inertial", "body"):
        force = jax.jit(filtered_force, static_argnums=3)(Vondrak(frame=frame), log.dtheta, log.dvel, log.dt)
        middle = slice(2000, 8000)
        left[frame] = np.abs(np.asarray(force)[middle] - clean.dvel[middle]).max() / log.dt
    assert left["inertial"] < 0.002  # of 0.1 m/s^2
    assert left["body"] > 5 * left["inertial"]
    level = {}
    for name, prefilter in {"none": None, "vondrak": Vondrak()}.items():
        method = build("gravity_q", prefilter=prefilter)
        level[name] = np.abs(attitude_error_deg(align(method, log), log)[400:800, 0]).max()
    assert level["vondrak"] < level["none"]


@pytest.mark.slow
def test_averages_know_nothing_of_vondrak():
    """The theorem: weighted sums up to t^2 are preserved, so TRIAD on whole means is the same with and without."""
    log = simulate("disturbed", seed=1, duration=60.0, condition=2, amplitude_mg=10.0)
    found = [align(build("triad", prefilter=p), log, every=600).q_nb[-1] for p in (None, Vondrak(frame="body"))]
    np.testing.assert_allclose(found[0], found[1], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fir", "vondrak", "wavelet"])
def test_by_name_in_front_of_a_method(name):
    assert set(PREFILTERS) == {"vondrak", "fir", "wavelet"}
    pytest.importorskip("pywt")
    log = simulate("disturbed", seed=1, duration=60.0, condition=2, amplitude_mg=10.0)
    method = build("dual_vector", parameters={"front_end.prefilter.frame": "body", "vectors": "boxcar"}, prefilter=name)
    assert isinstance(method.front_end.prefilter, PREFILTERS[name])
    assert method.front_end.prefilter.frame == "body"
    error = attitude_error_deg(align(method, log, every=600), log)[-1]
    assert np.abs(error[:2]).max() < 0.02
    noise = float(align(method, log, every=600).aid_sd[-1])
    assert noise == pytest.approx(float(align(build("dual_vector"), log, every=600).aid_sd[-1]))  # of the raw force


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: build("oba", "body", prefilter="vondrak"), "smooths the force of a standing vehicle"),
        (lambda: build("triad", prefilter="vondark"), "did you mean vondrak"),
        (lambda: with_parameters(build("triad"), {"front_end.prefilter.cutoff": 1}), "there is no prefilter to set"),
        (lambda: with_parameters(Fir(), {"cutoff": 3.0}), "outside its bounds 0.2 .. 1 Hz"),
        (lambda: Fir()(jnp.ones((500, 3)), 1.0), "at least 4 Hz"),
        (lambda: Wavelet(wavelet="sinc"), "orthogonal"),
        (lambda: Wavelet(cutoff=0.0), "cutoff"),
        (lambda: Wavelet()(jnp.ones((500, 3)), DT), "too short for 8 levels of db4: it takes at least 9.0 s"),
        (lambda: filtered_force(Vondrak(), np.ones((3, 3)), np.ones((3, 3)), DT), "at least 4 samples"),
        (lambda: filtered_force(Vondrak(frame="earth"), np.ones((9, 3)), np.ones((9, 3)), DT), "one of inertial, body"),
        (lambda: multitaper(np.ones(100), DT, 4.0, 9), "1 to 2 NW"),
        (lambda: misfit(np.arange(5.0), np.ones(5), np.ones(5), 9.0), "split"),
        (lambda: epochs_from_log(simulate("dvl-sturn", 1, duration=5.0), prefilter=Fir()), "standing vehicle"),
    ],
)
def test_refused(make, words):
    with pytest.raises(UserError, match=words):
        make()

"""The 4x4 eigenproblem: accuracy down to closing gaps, its derivative, and where no derivative exists."""

from decimal import Decimal, localcontext

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numeric import EPS, assert_derivatives
from scipy.spatial.transform import Rotation

from jaxalign.estimate.eigenproblem import davenport, dominant_eigenvector
from jaxalign.vector import Mat3, Vec3

UPPER = np.triu_indices(4)


@jax.jit
def solve_b(b):
    found = davenport(Mat3(*(Vec3.of(b[..., i, :]) for i in range(3))))
    return found.vector.array, found.value, found.gap


@jax.jit
def solve_k(k):
    found = dominant_eigenvector(tuple(k[..., i, j] for i, j in zip(*UPPER, strict=True)))
    return found.vector.array, found.value, found.gap


def signed(b):
    """Eigenvector with a fixed sign, value and gap: smooth near a generic b."""
    q, value, gap = solve_b(b)
    return jnp.concatenate([q * jnp.sign(q[jnp.argmax(jnp.abs(q))]), value[None], gap[None]])


def k_matrix(b):
    """Davenport's matrix in block form: K = [[tr B, z^T], [z, B + B^T - tr B I]], z = sum beta x alpha."""
    z = np.array([b[2, 1] - b[1, 2], b[0, 2] - b[2, 0], b[1, 0] - b[0, 1]])
    k = np.empty((4, 4))
    k[0, 0], k[0, 1:], k[1:, 0] = np.trace(b), z, z
    k[1:, 1:] = b + b.T - np.trace(b) * np.eye(3)
    return k


def exact_dominant(k):
    """The largest eigenpair to 40 digits: inverse iteration in decimal arithmetic."""
    with localcontext() as context:
        context.prec = 60
        values, vectors = np.linalg.eigh(k)
        exact = [[Decimal(float(x)) for x in row] for row in k]
        x = [Decimal(float(c)) for c in vectors[:, -1]]
        shift = Decimal(float(values[-1])) + Decimal(float(values[-1] - values[-2])) / 1000
        for _ in range(16):  # each pass gains three digits
            x = _solve_linear([[a - shift * (i == j) for j, a in enumerate(row)] for i, row in enumerate(exact)], x)
            norm = sum(c * c for c in x).sqrt()
            x = [c / norm for c in x]
        value = sum(x[i] * exact[i][j] * x[j] for i in range(4) for j in range(4))
        residual = max(abs(sum(exact[i][j] * x[j] for j in range(4)) - value * x[i]) for i in range(4))
        assert residual < Decimal(10) ** -40 * Decimal(float(np.abs(k).max()))
        return x, value


def _solve_linear(a, b):
    """Gauss with row pivoting."""
    rows = [[*row, c] for row, c in zip(a, b, strict=True)]
    for i in range(4):
        pivot = max(range(i, 4), key=lambda r: abs(rows[r][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for r in range(i + 1, 4):
            factor = rows[r][i] / rows[i][i]
            rows[r] = [x - factor * y for x, y in zip(rows[r], rows[i], strict=True)]
    x = [Decimal(0)] * 4
    for i in reversed(range(4)):
        x[i] = (rows[i][4] - sum(rows[i][j] * x[j] for j in range(i + 1, 4))) / rows[i][i]
    return x


def distance(q, p):
    """Between two unit vectors of unknown sign."""
    return np.minimum(np.linalg.norm(q - p, axis=-1), np.linalg.norm(q + p, axis=-1))


def weighted_sets(count, rng, noise=0.1):
    """Vectors a, b, weights w and the profile matrices sum w a b^T of noisy rotated sets."""
    b = rng.normal(size=(count, 6, 3))
    w = rng.uniform(0.1, 2, size=(count, 6))
    turns = Rotation.random(count, rng=rng).as_matrix()
    a = np.einsum("nij,nkj->nki", turns, b) + noise * rng.normal(size=b.shape)
    return a, b, w, np.einsum("nk,nki,nkj->nij", w, a, b)


def test_attitude_of_weighted_sets_as_scipy_finds_it():
    a, b, w, profiles = weighted_sets(100, np.random.default_rng(7))
    q, value, _ = solve_b(profiles)
    for i in range(100):
        theirs = Rotation.align_vectors(a[i], b[i], weights=w[i])[0]  # a = C b
        assert distance(q[i], np.roll(theirs.as_quat(), 1)) < 1e-12
        aligned = np.sum(w[i, :, None] * a[i] * theirs.apply(b[i]))
        assert float(value[i]) == pytest.approx(aligned, rel=1e-14)


def test_eigenvalues_as_numpy_finds_them():
    profiles = np.random.default_rng(8).normal(size=(200, 3, 3))
    q, value, gap = solve_b(profiles)
    for i, b in enumerate(profiles):
        values, vectors = np.linalg.eigh(k_matrix(b))
        scale = np.max(np.abs(values))
        assert abs(value[i] - values[-1]) < 20 * EPS * scale
        assert abs(gap[i] - (values[-1] - values[-2])) < 40 * EPS * scale
        assert distance(q[i], vectors[:, -1]) < 40 * EPS * scale / (values[-1] - values[-2])


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e8])
@pytest.mark.parametrize("gap", [1.0, 1e-3, 1e-6, 1e-9])
def test_error_times_gap_stays_at_rounding(gap, scale):
    """A backward stable solver errs by a few eps |K| / gap, and no more, however small the gap."""
    rng = np.random.default_rng(9)
    matrices = []
    for _ in range(25):
        frame, _ = np.linalg.qr(rng.normal(size=(4, 4)))
        spectrum = np.array([1.0, 1.0 - gap, *rng.uniform(-1, 1 - 2 * gap if gap < 1 else -0.5, size=2)])
        k = frame @ np.diag(spectrum) @ frame.T * scale
        matrices.append((k + k.T) / 2)
    q, value, found_gap = (np.asarray(x) for x in solve_k(np.stack(matrices)))
    for i, k in enumerate(matrices):
        vector, exact = exact_dominant(k)
        sign = 1 if sum(Decimal(float(a)) * b for a, b in zip(q[i], vector, strict=True)) > 0 else -1
        error = np.linalg.norm([float(sign * Decimal(float(a)) - b) for a, b in zip(q[i], vector, strict=True)])
        assert error * gap < 8 * EPS
        assert abs(float(Decimal(float(value[i])) - exact)) < 8 * EPS * scale
        assert found_gap[i] / scale == pytest.approx(gap, abs=16 * EPS)
        assert abs(q[i] @ q[i] - 1) < 16 * EPS


@pytest.mark.parametrize("zeros", [0.0, 0.5])
def test_five_sweeps_suffice(zeros):
    """Residual |K q - l q| of many matrices, full and with entries missing: rounding, never a slow straggler."""
    rng = np.random.default_rng(25)
    k = np.triu(rng.normal(size=(100_000, 4, 4)) * (rng.random(size=(100_000, 4, 4)) >= zeros))
    k = k + k.swapaxes(1, 2)
    q, value, gap = (np.asarray(x) for x in solve_k(k))
    residual = np.linalg.norm(np.einsum("nij,nj->ni", k, q) - value[:, None] * q, axis=1)
    assert np.max(residual / np.linalg.norm(k, axis=(1, 2)).clip(1e-300)) < 8 * EPS
    values = np.linalg.eigvalsh(k)
    assert np.max(np.abs(value - values[:, -1])) < 100 * EPS
    assert np.max(np.abs(gap - (values[:, -1] - values[:, -2]))) < 200 * EPS


def test_derivatives():
    """Generic profiles: of all four pivots, and one whose attitude is the identity to 1e-12."""
    rng = np.random.default_rng(10)
    _, b, w, profiles = weighted_sets(5, rng)
    upright = np.einsum("k,ki,kj->ij", w[0], b[0], b[0]) + 1e-12 * rng.normal(size=(3, 3))
    points = np.concatenate([profiles, upright[None]])
    points /= np.abs(points).max(axis=(1, 2), keepdims=True)
    assert_derivatives(signed, points, third=300.0, steps=(1e-3, 1e-4), noise=100.0)


def test_derivative_of_the_value_is_the_attitude():
    """tr(C^T B) is largest at C, so its derivative with respect to B is C itself."""
    profile = weighted_sets(1, np.random.default_rng(11))[3][0]
    dcm = Rotation.from_quat(np.roll(solve_b(profile)[0], -1)).as_matrix()
    np.testing.assert_allclose(jax.grad(lambda b: solve_b(b)[1])(profile), dcm, rtol=0, atol=1e-14)


@pytest.mark.parametrize("gap", [1e-3, 1e-6])
def test_derivative_with_a_small_gap(gap):
    """Perturbation theory in the known eigenvectors: dq = sum_k v_k (v_k dK q) / (l_1 - l_k)."""
    rng = np.random.default_rng(12)
    frame, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    spectrum = np.array([1.0, 1.0 - gap, -0.3, -0.9])
    k, dk = frame @ np.diag(spectrum) @ frame.T, rng.normal(size=(4, 4))
    dk = dk + dk.T
    (q, _, _), (dq, dvalue, dgap) = jax.jvp(solve_k, (k,), (dk,))
    first, others = frame[:, 0], frame[:, 1:]
    first = first * np.sign(first @ np.asarray(q))
    expected = others @ (others.T @ dk @ first / (1.0 - spectrum[1:]))
    # the vectors are good to eps / gap, and so is the product; then divided by the gap
    tolerance = 100 * EPS / gap**2
    np.testing.assert_allclose(dq, expected, rtol=0, atol=tolerance)
    assert float(dvalue) == pytest.approx(first @ dk @ first, abs=100 * EPS / gap)
    second = frame[:, 1] @ dk @ frame[:, 1]
    assert float(dgap) == pytest.approx(first @ dk @ first - second, abs=100 * EPS / gap)


JACOBIANS = [jax.jit(mode(lambda b: solve_b(b)[0])) for mode in (jax.jacfwd, jax.jacrev)]
REPEATED = {
    "no vector": np.zeros((3, 3)),
    "one vector": np.outer([0.3, -0.5, 9.8], [1.0, 2.0, -9.0]),
    "one vector along the axes": np.diag([0.0, 0.0, 96.0]),
    "two equal sums": np.diag([1.0, 1.0, -1.0]),
    "tiny": np.outer([0.3, -0.5, 9.8], [1.0, 2.0, -9.0]) * 1e-30,
}


@pytest.mark.parametrize("name", REPEATED)
def test_repeated_largest_eigenvalue(name):
    """No derivative exists; what is returned is finite, and zero along the directions that are undetermined."""
    b = REPEATED[name]
    scale = max(np.abs(b).max(), 1e-300)
    q, value, gap = solve_b(b)
    assert abs(float(gap)) <= 40 * EPS * scale
    assert abs(q @ q - 1) < 16 * EPS
    assert float(value) == pytest.approx(np.linalg.eigvalsh(k_matrix(b))[-1], abs=40 * EPS * scale)
    for derivative in JACOBIANS:
        jacobian = np.asarray(derivative(b))
        # the other eigenvalues lie at least |K| away; a closed gap would show as 1e12 / |K|
        assert np.all(np.abs(jacobian) < 10 / scale)
        if name == "no vector":
            assert not np.any(jacobian)


@pytest.mark.slow
def test_second_derivatives_where_they_exist():
    """Hessian-vector products against central differences of the gradient at two step sizes."""
    rng = np.random.default_rng(13)
    profiles = weighted_sets(4, rng)[3]
    points = profiles / np.abs(profiles).max(axis=(1, 2), keepdims=True)
    direction = rng.normal(size=(3, 3))
    gradient = jax.jit(jax.vmap(jax.jacrev(signed)))
    product = jax.jit(jax.vmap(lambda b: jax.jvp(jax.jacrev(signed), (b,), (direction,))[1]))(points)
    for step in (1e-4, 1e-5):
        differences = (gradient(points + step * direction) - gradient(points - step * direction)) / (2 * step)
        np.testing.assert_allclose(product, differences, rtol=0, atol=1e3 * step**2 + 1e3 * EPS / step)


def test_lanes_are_independent():
    """A batch, a vmap and a loop give the same numbers, also next to NaN and degenerate neighbours."""
    profiles = np.random.default_rng(14).normal(size=(2, 3, 3, 3))
    profiles[0, 1], profiles[1, 2] = np.nan, 0.0
    together = solve_b(profiles)
    mapped = jax.jit(jax.vmap(jax.vmap(solve_b)))(profiles)
    for i in range(2):
        for j in range(3):
            for one, all_, vmapped in zip(solve_b(profiles[i, j]), together, mapped, strict=True):
                np.testing.assert_allclose(all_[i, j], one, rtol=0, atol=8 * EPS)
                np.testing.assert_allclose(vmapped[i, j], one, rtol=0, atol=8 * EPS)
    assert np.all(np.isnan(together[0][0, 1]))
    assert np.all(np.isfinite(np.delete(np.asarray(together[0]).reshape(6, 4), 1, axis=0)))

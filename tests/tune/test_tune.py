"""Tuning: the gradient is that of the study's own errors, the search ends where a grid does, errors are said."""

import dataclasses
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxalign import UserError, with_parameters
from jaxalign.cli.main import main
from jaxalign.method_file import read_method
from jaxalign.methods import build
from jaxalign.parametrization import parameters
from jaxalign.simulate import scenario
from jaxalign.study import Study
from jaxalign.study import run as run_study
from jaxalign.tune import Rmse, Tune, engine, run
from jaxalign.tune.objective import loss_and_slope
from jaxalign.weight import AbstractWeight

RUNS = 32


def of(made, method="roba", paths="weight.threshold", **more):
    """Always the same shapes: one compilation."""
    return Tune(made, method, paths, **{"runs": RUNS, "held_out": RUNS, **more})


@pytest.fixture(scope="module")
def made():
    return scenario("dvl-sturn", outliers="fixed", duration=120.0)


@pytest.fixture(scope="module")
def tune(made):
    """From far below the optimum."""
    return of(made, build("roba", "body", {"weight.threshold": 0.2}), steps=30, rate=0.3, seed=2)


@pytest.fixture(scope="module")
def tuned(tune):
    return run(tune)


def test_a_search_is_a_dataclass(made):
    """What was left out has been put in; another search is made of it."""
    tune = of(made)
    assert (tune.batch, tune.recipe, tune.paths) == (RUNS, "roba", ("weight.threshold",))
    again = dataclasses.replace(tune, steps=7)
    assert (again.steps, again.batch, again.recipe, again.space.paths) == (7, RUNS, "roba", tune.space.paths)


def test_the_loss_is_the_accuracy_of_the_study(tune):
    tuned = run(of(tune.scenario, tune.method, steps=2, seed=2))
    study = run_study(Study(tune.scenario, {"roba": tune.method}, RUNS, seed=2))
    np.testing.assert_allclose(tuned.history.loss[0], study["roba"].accuracy.value[2], rtol=1e-9)


@pytest.mark.slow
def test_modes_agree_with_differences():
    whole = scenario("dvl-sturn", outliers="fixed")  # on a short log the slope is small beside the last bits
    objective, batch, _ = engine.prepared(of(whole, build("roba", "body", {"weight.threshold": 0.2}), seed=2))
    free = {"weight.threshold": jnp.asarray(0.3)}
    (one, forward), (two, reverse) = (
        eqx.filter_jit(loss_and_slope)(objective, free, batch, mode) for mode in ("forward", "reverse")
    )
    np.testing.assert_allclose(one, two, rtol=1e-9)  # two programs: the last bits grow a million times
    np.testing.assert_allclose(forward["weight.threshold"], reverse["weight.threshold"], rtol=1e-8)
    value = eqx.filter_jit(lambda x: objective({"weight.threshold": x}, batch))
    for h in (1e-4, 3e-5):
        numeric = (value(0.3 + h) - value(0.3 - h)) / (2 * h)
        np.testing.assert_allclose(forward["weight.threshold"], numeric, rtol=1e-3)


@pytest.mark.slow
def test_the_search_ends_where_a_grid_does(tune, tuned):
    objective, batch, _ = engine.prepared(tune)
    judge = engine._Judge(tune, objective, batch)
    space = tune.space
    gammas = np.geomspace(0.2, 9.0, 25)
    grid = [judge({"weight.threshold": jnp.asarray(space.maps["weight.threshold"].free(x))})[0] for x in gammas]
    assert min(tuned.history.loss) <= min(grid) + 0.02 * (max(grid) - min(grid))
    first = tuned.history.loss[0]
    assert min(tuned.history.loss) <= first - 0.9 * (first - min(grid))
    assert tuned.best == min(tuned.history.held)
    assert float(tuned.method.weight.threshold) == tuned.values["weight.threshold"]
    assert tuned.gain[0] < 0
    assert tuned.evaluations == RUNS * len(tuned.history.loss)


@pytest.mark.slow
def test_the_same_again(made):
    one, again = (run(of(made, steps=6, rate=0.3, seed=3)) for _ in range(2))
    assert again.history.loss == one.history.loss
    assert again.values == one.values


@pytest.mark.slow
def test_batches_take_all_runs_in_turn(made):
    seen = []
    tune = of(made, batch=12, steps=5, patience=0)
    taken = engine.taken

    def remembered(batch, runs):
        seen.append(runs)
        return taken(batch, runs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "taken", remembered)
        patch.setattr(engine, "_graded", lambda objective, free, batch, mode: (1.0, jax.tree.map(jnp.ones_like, free)))
        found = run(tune)
    assert [len(x) for x in seen] == [12] * 5
    assert set(np.concatenate(seen)[:RUNS]) == set(range(RUNS))
    assert found.evaluations == 60


@pytest.mark.slow
def test_own_optimiser_and_own_loss(made):
    tune = of(made, loss=lambda errors: jnp.mean(jnp.abs(errors.phi[..., 2])), steps=3)
    found = run(tune, optax.sgd(1.0))
    assert len(found.history.loss) == 3
    free = found.history.values["weight.threshold"]
    assert free[1] != free[0]


@pytest.mark.slow
def test_early_stop(made):
    found = run(of(made, steps=50, check=1, patience=2), optax.sgd(0.0))  # it stays where it is
    assert found.stopped == "nothing better over 2 looks at the runs held out"
    assert found.values == found.start
    assert len(found.history.loss) == 3


@pytest.mark.slow
def test_runs_without_an_attitude_count_as_any_angle():
    made = scenario("dvl-sturn", gaps=((0.0, 25.0),))
    tune = of(made, loss=Rmse(angle="pitch"), window=(0.0, 20.0))
    objective, batch, _ = engine.prepared(tune)
    np.testing.assert_allclose(objective(tune.space.origin, batch), 180 / np.sqrt(3))


class _Net(AbstractWeight):
    """Huber's rule by a network of nothing but a gain and an offset."""

    net: eqx.nn.Linear
    power: float = 1.0

    def init(self):
        return None

    def step(self, state, context, pair):
        size = pair.residual(context.attitude).norm() / context.sd
        return state, jax.nn.sigmoid(self.net(size[None])[0])


@pytest.mark.slow
def test_modules_of_a_method_are_tuned_in_reverse_mode(made):
    net = eqx.nn.Linear(1, 1, key=jax.random.key(0), dtype=jnp.float64)
    method = eqx.tree_at(lambda m: m.weight, build("roba", "body"), _Net(net))
    tune = of(made, method, ["weight.net"], steps=4, check=1)
    assert tune.chosen_mode == "reverse"
    found = run(tune)
    assert found.values == {}
    assert found.best < found.history.held[0]
    with pytest.raises(UserError, match="made by a recipe"):
        found.write("nowhere.json")


@pytest.mark.slow
def test_a_loss_that_becomes_nan_stops_and_keeps_the_last_good(made, tmp_path):
    class Breaks(Rmse):
        def __call__(self, errors):
            return jnp.where(Rmse()(errors) > limit, Rmse()(errors), jnp.nan)

    usual = run(of(made, steps=8, patience=0))
    losses = usual.history.loss
    assert losses == sorted(losses, reverse=True)
    limit = 0.5 * (losses[3] + losses[4])
    found = run(of(made, loss=Breaks(), steps=8, check=1, patience=0))
    assert found.stopped.startswith("the loss is not finite at step 4 (weight.threshold = ")
    assert np.isfinite(found.values["weight.threshold"])
    assert len(found.history.loss) == 4
    found.write(tmp_path / "kept.json")
    _, method, _ = read_method(tmp_path / "kept.json")
    assert float(method.weight.threshold) == found.values["weight.threshold"]


@pytest.mark.slow
def test_a_loss_that_is_nan_at_once(made):
    with pytest.raises(UserError, match="the loss is nan at the start"):
        run(of(made, loss=lambda errors: jnp.nan * errors.phi.sum()))


@pytest.mark.slow
def test_no_gradient_is_said(made):
    hard = of(made, "moba", "weight.threshold")
    with pytest.raises(UserError, match=r"does not change with weight.threshold .* exactly zero"):
        run(hard)
    both = of(made, "moba", ["weight.threshold", "weight.delta"], steps=1)
    said = []
    run(both, warn=said.append)
    assert len(said) == 1
    assert "does not change with weight.threshold" in said[0]


def test_interrupted(made):
    def interrupted(self, step, *args):
        if step == 10:
            raise KeyboardInterrupt
        return held_out(self, step, *args)

    held_out = engine.History.held_out
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine.History, "held_out", interrupted)
        found = run(of(made, steps=30, patience=0))
    assert found.stopped == "interrupted after 11 steps"
    assert found.best == min(found.history.held)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"paths": ["weight.treshold"]}, "did you mean weight.threshold"),
        ({"paths": ["estimate"]}, "did you mean weight.threshold"),
        ({"paths": []}, "name a parameter to tune: weight.threshold"),
        ({"paths": ["weight.threshold", "weight.threshold"]}, "named twice"),
        ({"method": "oba"}, "this method has no parameters to tune"),
        ({"method": "robba"}, "did you mean roba"),
        (
            {"method": "optimal_request", "paths": ["estimate.process_variance"]},
            "starts at zero, .* give it a positive start",
        ),
        ({"loss": "rsme"}, "did you mean rmse"),
        ({"loss": 3}, "loss = 3: must be one of"),
        ({"loss": "misfit"}, "weight.threshold has no part in it"),
        ({"runs": 1}, "runs = 1"),
        ({"batch": 5}, "batch = 5: must be a whole number from 2 to 4"),
        ({"held_out": 0}, "held_out = 0"),
        ({"steps": 0}, "steps = 0"),
        ({"rate": -1.0}, "rate = -1.0"),
        ({"mode": "both"}, "mode = 'both'"),
        ({"window": (50.0, 20.0)}, "no read-out is in it"),
        ({"fidelity": "x"}, "fidelity = 'x'"),
        ({"scenario": "dvl-stern"}, "did you mean 'dvl-sturn'"),
    ],
)
def test_bad_input(change, message, made):
    with pytest.raises(UserError, match=message) as found:
        Tune(**{"scenario": made, "method": "roba", "paths": ["weight.threshold"], "runs": 4, **change})
    assert "\n" not in str(found.value)


def test_values_outside_their_bounds():
    with pytest.raises(UserError, match=r"weight.threshold = 1000.0: outside its bounds 0.1 .. 10"):
        with_parameters(build("roba"), {"weight.threshold": 1000.0})


@pytest.mark.slow
def test_command_then_align_and_study(tmp_path, monkeypatch, capsys):
    """The shapes of the tests above, and their programs."""
    monkeypatch.chdir(tmp_path)

    def ran(command):
        assert main(command.split()) == 0, capsys.readouterr().err
        return capsys.readouterr().out

    some = "dvl-sturn --set outliers=fixed"
    search = f"--method roba --param weight.threshold --runs {RUNS} --held-out {RUNS} --steps 6"
    said = ran(f"tune {some} {search} --output t.json --plot t.png")
    assert "weight.threshold" in said
    assert "wrote t.json" in said
    content = json.loads((tmp_path / "t.json").read_text())
    name, method, _ = read_method(tmp_path / "t.json")
    assert (name, content["aids"][0]["kind"]) == ("roba", "body")
    assert parameters(method)["weight.threshold"] == content["tuned"]["values"]["weight.threshold"]
    assert content["tuned"]["settings"]["runs"] == RUNS
    ran(f"simulate {some} --output log.npz")
    ran("align log.npz --method-file t.json --output a.npz")
    with np.load(tmp_path / "a.npz") as file:
        assert json.loads(str(file["recipe"]))["parameters"]["weight.threshold"] == float(method.weight.threshold)
    said = ran(f"study {some} --method-file t.json --runs {RUNS}")
    assert "roba" in said
    assert "  t " in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tune", "dvl-sturn"], "name a method to tune"),
        (["tune", "dvl-sturn", "--method", "roba"], "name a parameter to tune: weight.threshold"),
        (["tune", "dvl-sturn", "--method", "roba", "--param", "threshhold"], "did you mean weight.threshold"),
        (
            ["tune", "dvl-sturn", "--method", "roba", "--param", "weight.threshold", "--share", "0.5"],
            "--share does not go with --loss rmse, but with quantile",
        ),
        (
            ["tune", "dvl-sturn", "--method", "roba", "--method-file", "x.json", "--param", "weight.threshold"],
            "or --method-file",
        ),
        (
            ["tune", "dvl-sturn", "--method-file", "x.json", "--param", "weight.threshold"],
            "x.json: no such method file",
        ),
        (["tune", "dvl-sturn", "--method", "roba", "--param", "weight.threshold", "--plot", "x.doc"], "--plot x.doc"),
        (
            ["tune", "dvl-sturn", "--method", "roba", "--param", "weight.threshold", "--output", "/no/x"],
            "there is no folder",
        ),
        (["study", "dvl-sturn", "--method-file", "x.json"], "no such method file"),
    ],
)
def test_wrong_flags(arguments, message, capsys):
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "no JSON"),
        ("[]", "not a method file"),
        ('{"method": "roba"}', "it has no entry 'aids'"),
        ('{"method": "x", "aids": [{"kind": "body"}], "prefilter": null, "parameters": {}}', "no method 'x'"),
        (
            '{"method": "roba", "aids": [{"kind": "body"}], "prefilter": null, "parameters": {"weight.threshold": 99}}',
            "outside its bounds",
        ),
        (
            '{"method": "roba", "aids": [{"kind": "static"}], "prefilter": null, "parameters": {}}',
            "does not take static",
        ),
        ('{"method": "roba", "aid": "body", "prefilter": null, "parameters": {}}', "written by an older version"),
    ],
)
def test_bad_method_files(content, message, tmp_path):
    (tmp_path / "m.json").write_text(content)
    with pytest.raises(UserError, match=message) as found:
        read_method(tmp_path / "m.json")
    assert "m.json" in str(found.value)
    assert "\n" not in str(found.value)

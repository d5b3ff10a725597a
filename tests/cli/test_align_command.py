"""jaxalign align: what it prints and writes, methods and files."""

import json
import re

import numpy as np
import pytest
from command_line import refused

import jaxalign as ja
from jaxalign.cli.main import main

PNG = b"\x89PNG\r\n\x1a\n"


def test_printed_times_are_those_of_the_file(files, tmp_path, capsys):
    cut = ["--method", "oba", "--start", "20", "--every", "40", "--output", str(tmp_path / "o.npz")]
    assert main(["align", str(files / "good.npz"), *cut]) == 0
    with np.load(tmp_path / "o.npz") as z:
        np.testing.assert_allclose(z["t"], [20.0, 60.0])
    assert "at 60.0 s: pitch" in capsys.readouterr().out


def test_wrong_column_map(files, capsys):
    message = refused(capsys, ["align", files / "good.csv", "--columns", files / "map.toml"])
    assert "map" in message


def test_swapped_axes_warn(files, capsys):
    assert main(["align", str(files / "swapped.npz"), "--method", "oba", "--every", "60"]) == 0
    assert "warning: " in capsys.readouterr().out


@pytest.mark.slow
def test_csv_of_a_standing_vehicle_is_static(files, capsys):
    """No aid columns: a static log. (This vehicle moves; the command only sees sensors.)"""
    assert main(["align", str(files / "good.csv"), "--end", "20", "--every", "20", "--imu", "navigation"]) == 0
    out = capsys.readouterr().out
    assert "no aid (standing)" in out
    assert "method robust_map" in out
    assert "its velocity is zero" in out


def test_align_writes_what_it_says(files, tmp_path, capsys):
    out, png = tmp_path / "out.npz", tmp_path / "out.png"
    arguments = ["--method", "oba", "--set", "observe.window=30", "--start", "10", "--end", "50"]
    assert main(["align", str(files / "good.npz"), *arguments, "--output", str(out), "--plot", str(png)]) == 0
    printed = capsys.readouterr().out
    for word in (
        "pitch deg",
        "roll deg",
        "heading deg",
        "observable",
        "residual",
        "as stated",
        "error against the reference",
    ):
        assert word in printed
    assert png.read_bytes().startswith(PNG)
    with np.load(out) as z:
        assert z["C_nb"].shape == (41, 3, 3)
        assert z["q_nb"].shape == (41, 4)
        assert z["euler_deg"].shape == (41, 3)
        for key in ("heading_deg", "observable", "eigengap", "weight", "status", "t"):
            assert z[key].shape == (41,)
        assert z["t"][0] == pytest.approx(10.0)
        assert np.isnan(z["C_nb"][:2]).all()
        assert np.isfinite(z["C_nb"][2:]).all()
        recipe = json.loads(str(z["recipe"]))
    assert recipe["method"] == "oba"
    assert recipe["parameters"]["observe.window"] == 30.0
    assert recipe["aid_sd"] == pytest.approx(0.1)
    assert recipe["aid_sd_from"] == "log"
    # The recipe rebuilds the method.
    again = ja.methods.build(recipe["method"], recipe["aids"], recipe["parameters"])
    assert ja.parameters(again) == recipe["parameters"]


@pytest.mark.slow
def test_aid_noise_is_estimated_where_it_is_not_stated(files, tmp_path, capsys):
    with np.load(files / "good.npz") as z:
        np.savez(tmp_path / "log.npz", **{k: z[k] for k in z.files if k != "aid_sd"})
    for method, told, stated in (
        ("oba", "estimated from the data", "0.2 m/s (as stated)"),
        ("robust_map", "m/s (by the data)", "by the data; stated: 0.2)"),
    ):
        command = ["align", str(tmp_path / "log.npz"), "--method", method, "--every", "60"]
        assert main([*command, "--output", str(tmp_path / "out.npz")]) == 0
        assert told in capsys.readouterr().out
        with np.load(tmp_path / "out.npz") as z:
            assert z["aid_sd"][-1] == pytest.approx(0.1, rel=0.3)
        assert main([*command, "--aid-sd", "0.2", "--output", str(tmp_path / "out.npz")]) == 0
        assert stated in capsys.readouterr().out
        with np.load(tmp_path / "out.npz") as z:
            recipe = json.loads(str(z["recipe"]))
        assert (recipe["aid_sd"], recipe["aid_sd_from"]) == (0.2, "user")


@pytest.mark.slow
def test_a_recipe_holds_the_figures_of_the_unit(files, tmp_path, capsys):
    """--imu reaches the method that is written, and its deviations need no --imu when it is read back."""
    out = tmp_path / "out.npz"
    command = ["align", str(files / "good.npz"), "--method", "robust_map", "--every", "60"]
    assert main([*command, "--imu", "mems", "--output", str(out)]) == 0
    end = capsys.readouterr().out.splitlines()[-2]
    with np.load(out) as z:
        recipe = json.loads(str(z["recipe"]))
    assert recipe["parameters"]["imu.gyro.bias_deg_h"] == 200.0
    (tmp_path / "again.json").write_text(json.dumps(recipe))
    assert main(["align", str(files / "good.npz"), "--method-file", str(tmp_path / "again.json"), "--every", "60"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == end


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "aid"),
    [(name, aid.kind) for name, recipe in ja.methods.RECIPES.items() for aid in recipe.aids if recipe.contract],
)
def test_every_recipe_aligns_a_file(tmp_path, capsys, name, aid):
    scenario = {"body": "dvl-sturn", "nav": "gps-zigzag", "static": "sway"}[aid]
    log = tmp_path / "log.npz"
    assert main(["simulate", scenario, "--set", "duration=60", "--output", str(log)]) == 0
    out = tmp_path / "out.npz"
    assert main(["align", str(log), "--method", name, "--every", "10", "--output", str(out)]) == 0
    assert "at 60.0 s: pitch" in capsys.readouterr().out
    with np.load(out) as found:
        recipe = json.loads(str(found["recipe"]))
        assert np.isfinite(found["C_nb"][-1]).all()
    assert recipe["method"] == {"auto": "robust_map"}.get(name, name)  # what was chosen
    ja.methods.build(recipe["method"], recipe["aids"], recipe["parameters"])  # the recipe builds the method again


def test_a_parameter_by_its_path(tmp_path, capsys):
    log, out = tmp_path / "log.npz", tmp_path / "out.npz"
    assert main(["simulate", "dvl-sturn", "--set", "duration=60", "--output", str(log)]) == 0
    assert main(["align", str(log), "--method", "moba", "--set", "weight.exponent=4", "--output", str(out)]) == 0
    with np.load(out) as found:
        assert json.loads(str(found["recipe"]))["parameters"]["weight.exponent"] == 4.0
    arguments = ["--method", "vo_tvk_as_published"]
    assert main(["align", str(log), *arguments, "--every", "10"]) == 0
    said = capsys.readouterr().out
    assert "THE FILTER IS SINGULAR" in said
    assert "NO ATTITUDE" in said
    assert "nan" not in said


@pytest.mark.slow
def test_fine_behind_a_prefilter(tmp_path, capsys):
    parked, out = tmp_path / "parked.npz", tmp_path / "out.npz"
    assert (
        main(["simulate", "disturbed", "--set", "amplitude_mg=10", "--set", "duration=20", "--output", str(parked)])
        == 0
    )
    align = [
        "align",
        str(parked),
        "--method",
        "fine",
        "--prefilter",
        "vondrak",
        "--set",
        "front_end.prefilter.cutoff=0.4",
    ]
    assert main([*align, "--every", "5", "--output", str(out)]) == 0
    said = capsys.readouterr().out
    assert "specific force behind Vondrak (frame inertial, cutoff 0.4)" in said
    assert "the filter's own standard deviations: east" in said
    assert "the standard deviations are not honest" in said
    assert "biases (right, forward, up): gyros" in said
    with np.load(out) as z:
        recipe = json.loads(str(z["recipe"]))
        assert (recipe["prefilter"], recipe["parameters"]["front_end.prefilter.cutoff"]) == ("vondrak", 0.4)
        assert z["covariance"].shape == (41, 15, 15)
        assert np.isnan(z["sd_deg"][0]).all()
        assert (z["sd_deg"][1:] > 0).all()
    for wrong, words in (
        (["--prefilter", "vondark"], "no prefilter 'vondark': did you mean vondrak"),
        (["--prefilter", "vondrak", "--set", "front_end.prefilter.cutof=1"], "did you mean front_end.prefilter.cutoff"),
        (
            ["--set", "front_end.prefilter.cutoff=1"],
            "there is no prefilter to set: choose one first (--prefilter NAME)",
        ),
        (["--prefilter", "wavelet"], "too short for 8 levels"),
    ):
        assert words in refused(capsys, ["align", parked, "--method", "fine", "--end", "5", *wrong])


def test_a_prefilter_is_for_standing_vehicles(files, capsys):
    said = refused(capsys, ["align", files / "good.npz", "--method", "oba", "--prefilter", "fir"])
    assert "smooths the force of a standing vehicle" in said


@pytest.mark.slow
def test_residuals_of_several_aids_and_of_single_components(tmp_path, capsys):
    """Each in its unit, over the components that there are; in the file by the name of the aid."""
    log, out, png = (tmp_path / name for name in ("car.npz", "out.npz", "out.png"))
    ja.io.write_npz(ja.simulate.simulate("car", 1, duration=40.0, heading_sd_deg=1.0), log)
    usual = ["align", str(log), "--method", "robust_map", "--every", "10", "--output", str(out), "--plot", str(png)]
    assert main(usual) == 0
    printed = capsys.readouterr().out
    assert "residual sd" in printed
    said = dict(re.findall(r"residual of (\S+)(?: per axis)?: rms ([\d.]+)", printed))
    with np.load(out) as z:
        for name, sd in (("odometer", 0.05), ("non-holonomic", 0.05), ("heading", 1.0)):
            assert 0.5 * sd < float(said[name]) < 1.5 * sd
            used = (z[f"{name}_weight"] > 0) & np.isfinite(z["heading_deg"])
            factor = np.rad2deg(1.0) if name == "heading" else 1.0
            rms = factor * np.sqrt(np.mean(np.square(z[f"{name}_residual"][used])))
            assert float(said[name]) == pytest.approx(rms, abs=1e-4)
        names = [str(name) for name in z["covariance_names"]]
        assert names[:6] == ["attitude"] * 3 + ["velocity"] * 3
        assert z["covariance"].shape[-1] == len(names)
        assert z["velocity"].shape == z["position"].shape == (len(z["t"]), 3)
    assert main([*usual, "--aid", "heading"]) == 0
    printed = capsys.readouterr().out
    assert "residual deg" in printed
    assert re.search(r"^residual: rms [\d.]+, largest [\d.]+ deg", printed, re.MULTILINE)
    assert png.read_bytes().startswith(PNG)

"""The README's code runs as it stands: Python in one namespace, commands one after the other."""

import re
import tomllib
from operator import attrgetter
from pathlib import Path

import matplotlib
import pytest

import jaxalign
from jaxalign.cli.main import main, parser

README = (Path(__file__).parents[2] / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.M | re.S)


def commands() -> list[str]:
    return [line[2:] for block in blocks("console") for line in block.splitlines() if line.startswith("$ ")]


def test_what_the_code_names_is_there():
    """Quickly; the slow tests below run it."""
    for block in blocks("python"):
        compile(block, "README.md", "exec")
        for name in re.findall(r"\bja\.([A-Za-z_][\w.]*\w)", block):
            attrgetter(name)(jaxalign)
    for command in commands():
        parser().parse_args(command.split()[1:])


@pytest.mark.slow
def test_python(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    space: dict = {}
    code = blocks("python")
    assert len(code) == 8
    for block in code:
        exec(compile(block, "README.md", "exec"), space)
    assert space["milder"].weight.cutoff == 8.0
    assert all(abs(float(x)) > 0 for x in space["gradient"])
    errors = dict(
        re.findall(r"^(plain|robust) heading error at the end (\S+) deg$", capsys.readouterr().out, flags=re.M)
    )
    assert abs(float(errors["robust"])) < 2.5 < abs(float(errors["plain"]))
    # The 20-line extension and the 15-line embedding keep their promise.
    assert len([line for line in code[5].splitlines() if line.strip()]) <= 20
    assert len([line for line in code[6].splitlines() if line.strip()]) <= 15


@pytest.mark.slow
def test_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert len(commands()) == 13
    for command in commands():
        program, *arguments = command.split()
        assert program == "jaxalign"
        assert main(arguments) == 0, capsys.readouterr().err
    assert (tmp_path / "out.npz").exists()


def test_column_map_is_a_map(tmp_path):
    from jaxalign.io.columns import column_map

    _, text, _ = blocks("toml")
    (tmp_path / "dvl.csv").write_text("t,vx,vy,vz\n")
    found = column_map(tomllib.loads(text), tmp_path / "log.csv")
    assert (found.turn, found.gyro, found.accel_unit) == (True, ("wx", "wy", "wz"), 9.80665)
    assert found.aids[0].file == tmp_path / "dvl.csv"
    assert found.aids[0].aid == jaxalign.BodyVelocity()


def test_file_of_figures_is_a_unit(tmp_path):
    from jaxalign.inertial_unit import imu_figures

    (tmp_path / "unit.toml").write_text(blocks("toml")[0])
    assert imu_figures(str(tmp_path / "unit.toml")).gyro.walk_deg_sqrt_h.tolist() == [0.1, 0.1, 0.2]


def test_scenario_file_is_a_scenario(tmp_path):
    from jaxalign.simulate import scenario_file

    (tmp_path / "harbour.toml").write_text(blocks("toml")[2])
    made = scenario_file(tmp_path / "harbour.toml")
    assert (made.name, made.duration, float(made.aids[0].sd)) == ("harbour", 120.0, 0.03)


@pytest.mark.parametrize("link", re.findall(r"\]\((?!https?:)([^)#]+)\)", README))
def test_links_exist(link):
    assert (Path(__file__).parents[2] / link).exists()


def test_methods_table_is_complete():
    from jaxalign.methods import RECIPES

    for name in RECIPES:
        assert f"| `{name}` |" in README

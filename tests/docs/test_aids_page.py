"""docs/aids.md runs as it stands: Python in one namespace, maps, scenario files and commands."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from jaxalign.cli.main import main, parser

PAGE = (Path(__file__).parents[2] / "docs" / "aids.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, flags=re.M | re.S)


def test_the_column_map_is_one(tmp_path):
    from jaxalign.io.columns import column_map

    text = blocks("toml")[0]
    odometer, wheels, compass = column_map(tomllib.loads(text), tmp_path / "log.csv").aids
    assert (odometer.aid.name, odometer.values, odometer.unit, odometer.sd) == ("odometer", ("speed",), 1 / 3.6, 0.05)
    assert (wheels.values, wheels.sd) == ((), 0.02)
    assert (compass.unit, compass.sd) == (np.pi / 180, np.pi / 180)


def test_the_scenario_file_is_one(tmp_path):
    from jaxalign.simulate import scenario_file

    (tmp_path / "car.toml").write_text(blocks("toml")[1])
    made = scenario_file(tmp_path / "car.toml")
    assert [aid.aid.name for aid in made.aids] == ["odometer", "non-holonomic", "heading"]
    assert [aid.stride for aid in made.aids] == [1, 1, 10]


def test_commands_are_understood():
    for command in "".join(blocks("sh")).splitlines():
        program, *arguments = command.split()
        assert program == "jaxalign"
        parser().parse_args(arguments)


@pytest.mark.slow
def test_all_of_it_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    space: dict = {}
    for block in blocks("python"):
        exec(compile(block, "docs/aids.md", "exec"), space)
    headings = re.findall(r"^(\S+) \+- (\S+) deg$", capsys.readouterr().out, flags=re.M)
    alone, aided = (float(sd) for _, sd in headings[-2:])
    assert 8 < alone < 11  # the page says 9.5, then 0.3
    assert 0.2 < aided < 0.4
    (tmp_path / "car.toml").write_text(blocks("toml")[1])
    space["ja"].io.write_npz(space["log"], "car.npz")
    for command in "".join(blocks("sh")).splitlines():
        arguments = command.replace("--runs 100", "--runs 4").split()[1:]
        assert main(arguments) == 0, capsys.readouterr().err

"""docs/faults.md runs as it stands; that its tables are complete is asked in tests/simulate."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text(), flags=re.M | re.S)


def test_the_scenario_file_is_one(tmp_path):
    from jaxalign.simulate import scenario_file

    (tmp_path / "own.toml").write_text(blocks("toml")[0])
    assert [type(x).__name__ for x in scenario_file(tmp_path / "own.toml").imu_faults] == ["ScaleFactor", "Saturation"]


@pytest.mark.slow
def test_python():
    space: dict = {}
    for block in blocks("python"):
        exec(compile(block, "docs/faults.md", "exec"), space)
    assert {"frd", "gyro-deg"} < set(space["fitting"])
    assert "ned" not in space["fitting"]


def test_links_exist():
    for link in re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", PAGE.read_text()):
        assert (PAGE.parent / link).exists()

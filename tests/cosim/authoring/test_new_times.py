"""Times that `retune new` takes from default experiments and tables: start, stop, macro step and change."""

import re
import tomllib

import pytest

from cosim.authoring.check import check
from cosim.authoring.draft import draft

PLANT = """<ScalarVariable name="y" valueReference="0" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="m" valueReference="1" causality="parameter" variability="tunable"><Real start="2"/>
</ScalarVariable>
"""


@pytest.fixture
def drafted(described, tmp_path):
    """drafted(experiment of the plant, times of the table): the path of a draft, its table of times, and its change."""

    def write(experiment, times=()):
        fmus = {"plant": described(PLANT, name="P", experiment=experiment)}
        if times:
            fmus["reference"] = tmp_path / "sp.csv"
            fmus["reference"].write_text("time,y_ref\n" + "".join(f"{t},1\n" for t in times))
        path = tmp_path / "my.toml"
        path.write_text(draft(fmus, tmp_path).text)
        times = tomllib.loads(path.read_text())["scenario"]
        (change,) = re.findall(r'^# "plant.m" = (\[\[.*\]\])', path.read_text(), flags=re.M)
        return path, (times.get("start_time"), times["stop_time"], times["macro_step"]), change

    return write


@pytest.mark.parametrize(
    ("experiment", "table", "times", "change"),
    [
        ('startTime="100" stopTime="105"', (), (100.0, 105.0, 0.005), "[[100.0, 2.0], [101.67, 3]]"),
        ('stopTime="9"', (100, 105), (100.0, 105.0, 0.005), "[[100.0, 2.0], [101.67, 3]]"),
        ('stopTime="5" stepSize="0.01"', (-5, -1), (-5.0, -1.0, 0.01), "[[-5.0, 2.0], [-3.67, 3]]"),
        ('startTime="1" stopTime="2" stepSize="0.3"', (), (1.0, 1.9, 0.3), "[[1.0, 2.0], [1.333, 3]]"),
        ('startTime="100000" stopTime="100005"', (3,), (1e5, 100005.0, 0.005), "[[100000.0, 2.0], [100001.67, 3]]"),
        ('startTime="0" stopTime="5"', (), (None, 5.0, 0.005), "[[0.0, 2.0], [1.67, 3]]"),
    ],
    ids=["FMU", "table", "before zero", "part of a step", "one row is no run", "from zero"],
)
def test_a_run_begins_and_ends_as_the_source_of_its_times_does(drafted, experiment, table, times, change):
    assert drafted(experiment, table)[1:] == (times, change)


@pytest.mark.parametrize(
    ("experiment", "times"),
    [
        ('stopTime="INF"', (None, 10.0, 0.01)),
        ('startTime="-INF" stopTime="5"', (None, 10.0, 0.01)),
        ('startTime="-1e308" stopTime="1.7e308"', (None, 10.0, 0.01)),
        ('stopTime="1e-320"', (None, 10.0, 0.01)),
        ('startTime="6" stopTime="5"', (None, 10.0, 0.01)),
        ('stopTime="5" stepSize="1e-310"', (None, 5.0, 0.005)),
        ('stopTime="5" stepSize="INF"', (None, 5.0, 0.005)),
    ],
)
def test_times_that_no_scenario_can_have_count_as_not_declared(drafted, experiment, times):
    path, found, _ = drafted(experiment)
    assert found == times
    assert not [str(f) for f in check(path) if f.is_error and f.where.startswith("scenario")]


def test_the_number_of_macro_steps_is_said(drafted):
    path, _, _ = drafted('stopTime="5" stepSize="0.01"', (0, 4000))
    assert re.search(r"^macro_step = 0.01 +# s, of p\.fmu: 400,000 steps$", path.read_text(), flags=re.M | re.I)

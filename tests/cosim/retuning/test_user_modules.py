"""A scenario's own modules: each scenario gets what lies beside it."""

import json
import sys

import pytest

from cosim import ScenarioError
from cosim.user_code import load


@pytest.fixture(autouse=True)
def modules():
    before = dict(sys.modules)
    yield
    sys.modules.clear()
    sys.modules.update(before)


def test_two_scenarios_have_each_the_model_beside_it(tmp_path):
    for n in (1, 2):
        (tmp_path / str(n)).mkdir()
        (tmp_path / str(n) / "twin_model.py").write_text(f"value = {n}\n")
    assert [load("twin_model:value", tmp_path / n) for n in ("1", "2", "1")] == [1, 2, 1]


def test_a_package_is_another_one_with_all_that_is_in_it(tmp_path):
    for n in (1, 2):
        folder = tmp_path / str(n) / "twin_package"
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text("")
        (folder / "inner.py").write_text(f"value = {n}\n")
    assert [load("twin_package.inner:value", tmp_path / n) for n in ("1", "2")] == [1, 2]


def test_a_module_is_loaded_once_for_one_scenario(tmp_path):
    (tmp_path / "single_model.py").write_text("value = object()\n")
    assert load("single_model:value", tmp_path) is load("single_model:value", tmp_path)


def test_nothing_that_is_installed_is_let_go_of(tmp_path):
    (tmp_path / "json.py").write_text("value = 1\n")
    with pytest.raises(ScenarioError, match="cannot load 'json:value'"):
        load("json:value", tmp_path)
    assert sys.modules["json"] is json

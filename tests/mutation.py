"""Mutation tests: a check that passes on a wrong formula cannot bite.

    MUTANTS = [
        # id, module, old, new, the checks that must reject it
        ("cross-sign", "fmu_models.kernel.so3", "a[2] * b[0] - a[0] * b[2]", "a[0] * b[2] - a[2] * b[0]", ("algebra",)),
    ]
    TestMutants = mutation_tests(MUTANTS, {"algebra": check_vector_algebra})

A check takes a module, and raises AssertionError where one of its numbers is not the oracle's.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

Mutant = tuple[str, str, str, str, tuple[str, ...]]


def mutation_tests(mutants: Sequence[Mutant], checks: Mapping[str, Callable[[ModuleType], None]]) -> type:
    """Return a class of tests: each mutant is rejected, its unchanged source is not, and every check has a mutant."""
    rejections = [
        pytest.param(module, old, new, check, id=f"{name}-{check.removeprefix('check_')}")
        for name, module, old, new, rejecting in mutants
        for check in rejecting
    ]
    sources = sorted({(module, check) for _, module, _, _, rejecting in mutants for check in rejecting})

    @pytest.mark.full
    class Mutants:
        @pytest.mark.parametrize(("module", "old", "new", "check"), rejections)
        def test_a_wrong_formula_is_rejected(self, module, old, new, check):
            with pytest.raises(AssertionError, match="Not equal to tolerance"):
                checks[check](mutated(module, old, new))

        @pytest.mark.parametrize(("module", "check"), sources)
        def test_the_unchanged_source_passes(self, module, check):
            checks[check](mutated(module, "", ""))

        def test_every_check_has_a_mutant(self):
            assert set(checks) == {check for _, check in sources}

    return Mutants


def mutated(name: str, old: str, new: str) -> ModuleType:
    """Return the module of that name from its source with the one `old` replaced by `new`; unchanged where empty."""
    path = Path(find_spec(name).origin)
    source = path.read_text(encoding="utf-8")
    assert not old or source.count(old) == 1, f"{old!r} must be in {path.name} once, got {source.count(old)}"
    module = ModuleType(f"{name}_mutant")
    module.__package__ = name.rpartition(".")[0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, module.__name__, module)  # dataclasses look their module up there
        exec(compile(source.replace(old, new) if old else source, f"mutant of {path.name}", "exec"), module.__dict__)
    return module


def checks_of(oracles: ModuleType) -> dict[str, Callable[..., None]]:
    """Return the functions of a module whose names begin with check_."""
    return {name: check for name, check in vars(oracles).items() if name.startswith("check_")}

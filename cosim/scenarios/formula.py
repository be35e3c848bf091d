"""Formulas: of changes of the plant, in t, `0.2*exp(-0.2*t)*sin(1.5*t) + m0 if t <= 3 else 1.85`; of what is written
into the controller, in the estimated parameters, `20*J`.

Python's expression syntax with floats, arithmetic, comparisons, conditionals and the functions below; nothing else
can be named. Compiled once: a call takes 1 us, a general evaluator's 30.
"""

import ast
import math
import re
from collections.abc import Callable, Collection, Mapping
from keyword import iskeyword
from types import CodeType
from typing import Any, cast

from ..names import did_you_mean

FUNCTIONS: dict[str, Any] = {
    name: getattr(math, name)
    for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "sqrt", "tanh")
} | {"abs": abs, "min": min, "max": max, "floor": lambda x: float(math.floor(x)), "ceil": lambda x: float(math.ceil(x))}
CONSTANTS: dict[str, float] = {"pi": math.pi, "e": math.e}

_NODES = (
    ast.Expression, ast.Constant, ast.Name, ast.Load, ast.Call, ast.IfExp,
    ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.Mod, ast.UnaryOp, ast.USub, ast.UAdd, ast.Not,
    ast.Compare, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq, ast.BoolOp, ast.And, ast.Or,
)  # fmt: skip


def identifier(name: str) -> str:
    """Return the name as one that a formula, or a function's argument, can have: `inertia_J` for `inertia.J`.

    Keywords and functions of formulas are none: `p_min` for `min`.
    """
    plain = re.sub(r"\W+", "_", name).strip("_")
    return plain if plain.isidentifier() and not iskeyword(plain) and plain not in FUNCTIONS else f"p_{plain}"


def compile_formula(text: str, definitions: Mapping[str, Callable[[float], float]]) -> Callable[[float], float]:
    """Compile a formula to a function of t [s]. definitions: further functions of t that it may name.

    Raises ValueError, in one line, for anything but a formula. The function raises ArithmeticError or ValueError where
    the formula has no value.
    """
    code, text, used = _compiled(text, {"t", *definitions})
    inner = {name: definitions[name] for name in sorted(used & set(definitions))}

    def evaluate(t: float) -> float:
        value = eval(code, _KNOWN, {"t": t} | {name: f(t) for name, f in inner.items()})
        if isinstance(value, complex):
            raise ValueError(f"'{text}' is complex at t = {t:g} s.")
        return float(value)

    return evaluate


def compile_expression(text: str, names: Collection[str]) -> Callable[[Mapping[str, float]], float]:
    """Compile a formula to a function of values by name; names: those that it may use.

    Raises as `compile_formula` does.
    """
    code, text, _ = _compiled(text, names)

    def evaluate(values: Mapping[str, float]) -> float:
        value = eval(code, _KNOWN, dict(values))
        if isinstance(value, complex):
            raise ValueError(f"'{text}' is complex")
        return float(value)

    return evaluate


_KNOWN: dict[str, Any] = {"__builtins__": {}} | FUNCTIONS | CONSTANTS


def _compiled(text: str, names: Collection[str]) -> tuple[CodeType, str, set[str]]:
    """Return a formula compiled, its text in one line, and the names in it. Raises ValueError."""
    text = " ".join(text.split())
    try:
        tree = ast.parse(text, mode="eval")
        for node in ast.walk(tree):
            _check(node, text, names)
        called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Name) and node.id in FUNCTIONS and id(node) not in called:
                raise ValueError(f"'{text}' has the function {node.id} without its arguments.")
            if isinstance(node, ast.Constant):
                node.value = float(cast(float, node.value))  # so that a power overflows instead of growing
        code = compile(tree, "<formula>", "eval")
    except (SyntaxError, RecursionError, MemoryError, OverflowError) as e:
        raise ValueError(f"'{text[:80]}' is not a formula: {getattr(e, 'msg', type(e).__name__)}.") from e
    return code, text, {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}


def _check(node: ast.AST, text: str, names: Collection[str]) -> None:
    """Check that the node may stand in a formula. Raises ValueError."""
    if not isinstance(node, _NODES):
        raise ValueError(f"'{text}' has {type(node).__name__}; a formula has numbers, names, arithmetic and functions.")
    if isinstance(node, ast.Constant) and type(node.value) not in (int, float):
        raise ValueError(f"'{text}' has {node.value!r}; a formula's constants are numbers.")
    if isinstance(node, ast.Call) and (not isinstance(node.func, ast.Name) or node.func.id not in FUNCTIONS):
        raise ValueError(f"'{text}' calls {ast.unparse(node.func)}; the functions are {', '.join(sorted(FUNCTIONS))}.")
    if isinstance(node, ast.Call):
        name, n = ast.unparse(node.func), len(node.args)
        if node.keywords:
            raise ValueError(f"'{text}' calls {name} with a keyword argument.")
        fits = n >= 2 if name in ("min", "max") else n == (2 if name == "atan2" else 1)
        if not fits and not any(isinstance(a, ast.Starred) for a in node.args):  # refused as such
            raise ValueError(f"'{text}' calls {name} with {n} arguments.")
    if isinstance(node, ast.Name):
        known = {*names, *FUNCTIONS, *CONSTANTS}
        if node.id not in known:
            hint = did_you_mean(node.id, known) or f"; it may have {', '.join(sorted({*names, *CONSTANTS}))}."
            raise ValueError(f"the formula '{text}' has an unknown name, '{node.id}'{hint}")

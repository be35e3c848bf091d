"""The rows `native` and `python` of catalogue.toml: what a running FMU does, and the one line that is told of it."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

from cosim.errors import SlaveError
from cosim.slaves.slave import open_slave
from cosim.slaves.supervision.fork_server import forked_processes

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for what is left in /proc"),
]
CATALOGUE = tomllib.loads(Path(__file__).with_name("catalogue.toml").read_text(encoding="utf-8"))
H = 0.01  # s
EXAMPLES = {"native": ("u", ["y", "limited"]), "python": ("u", ["y"])}


def rows(kind):
    """The rows of a kind; of those that differ only in where and when it happens, the first is in the quick tier."""
    seen = set()
    for row in CATALOGUE[kind]:
        of_where = r"[\w ]*\bat t = .*? s\b|in (instantiate|initialize)$"
        outcome = re.sub(of_where, "", row.get("expected") or row.get("logs") or row.get("prints", ""))
        yield pytest.param(row, id=row["inject"], marks=[pytest.mark.full] if outcome in seen else [])
        seen.add(outcome)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("row", list(rows("native")))
def test_native(native, row, caplog, capfd):
    check(native, "native", row, caplog, capfd)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("row", list(rows("python")))
def test_python(faulty, row, caplog, capfd):
    check(faulty, "python", row, caplog, capfd)


@pytest.mark.full
@pytest.mark.parametrize("row", [row.values[0] for row in rows("native")], ids=lambda row: row["inject"])
def test_native_in_a_forked_process(native, row, caplog, capfd):
    with forked_processes():
        check(native, "native", row, caplog, capfd)


@pytest.mark.full
@pytest.mark.parametrize("row", [row.values[0] for row in rows("python")], ids=lambda row: row["inject"])
def test_python_in_a_forked_process(faulty, row, caplog, capfd):
    with forked_processes():
        check(faulty, "python", row, caplog, capfd)


def check(fmu, kind, row, caplog, capfd):
    how, _, where = row["inject"].rpartition(" in ")
    is_early = where == "instantiate"
    name = f"instantiate: {how}" if is_early else "plant"
    fault, outputs = None, []
    with open_slave(fmu, name, timeout=row.get("timeout", 30.0), memory_limit=row.get("memory", 0.0)) as slave:
        try:
            name_of_input, names = EXAMPLES[kind]
            slave.bind(inputs=[name_of_input], outputs=names)
            run(slave, outputs, "" if is_early else how, "" if is_early else where)
        except SlaveError as error:
            fault = error
        if fault is not None:
            with pytest.raises(RuntimeError, match="must not be called after"):
                slave.get()
    printed = capfd.readouterr()
    told = str(fault)
    if "expected" in row:
        assert fault is not None, "it went on as if nothing had happened"
        assert re.fullmatch(row["expected"], told), told
        assert "\n" not in told
        assert fault.instance == name
        time = re.search(r"at t = (\S+) s", told)
        assert fault.time == (None if is_early else pytest.approx(float(time[1])))
        assert outputs == [(float(k), *((0.0,) if kind == "native" else ())) for k in range(len(outputs))]
    else:
        assert fault is None, told
        assert len(outputs) == 4
    assert printed.out == ""
    assert "Traceback" not in printed.err or kind == "python"  # what an FMU prints is its own
    messages = [record.getMessage() for record in caplog.records if record.levelname != "INFO"]
    if "logs" in row:
        assert any(re.fullmatch(row["logs"], message) for message in messages), messages
    else:
        assert [m for m in messages if not re.fullmatch(row.get("may_log", ""), m)] == []
    assert len(messages) <= 200
    assert re.search(row.get("prints", ""), printed.err), printed.err[:1000]
    assert len(printed.err) < 2 << 20


def run(slave, outputs, how, where):
    slave.initialize({"how": how, "where": where})
    for k in range(4):
        outputs.append(slave.step([float(k)], t=k * H, h=H))


def test_the_catalogue_is_as_long_as_it_says():
    of_fmus = [
        row for kind in ("archive", "description", "arrays", "library", "native", "python") for row in CATALOGUE[kind]
    ]
    assert len(of_fmus) >= 190
    for kind, rows in CATALOGUE.items():
        names = [row.get("inject") or row["fault"] for row in rows]
        assert len(set(names)) == len(names), kind

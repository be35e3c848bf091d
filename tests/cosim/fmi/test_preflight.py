"""The rules of preflight at their limits, one by one: what is refused a step beyond, and that the limit is taken.

Whole FMUs with these faults are in tests/faults.
"""

from zipfile import ZIP_BZIP2, ZIP_DEFLATED, ZIP_STORED, ZipInfo

import pytest
from fmpy import read_model_description

from cosim.fmi.elements import scalarized
from cosim.fmi.preflight.archive import archive_findings
from cosim.fmi.preflight.description import description_findings, index_findings
from cosim.fmi.preflight.xml import strict_root

MIB = 1 << 20


def told(findings):
    return [str(finding) for finding in findings]


# The archive, by entries as its directory has them.


def entries(*names, **attributes):
    """Entries of some bytes, one behind the other, with these attributes."""
    made, place = [], 0
    for name in names:
        entry = ZipInfo(name)
        entry.file_size = entry.compress_size = 100
        entry.CRC = 1
        for key, value in attributes.items():
            setattr(entry, key, value)
        entry.header_offset = place
        place += 30 + len(entry.orig_filename) + entry.compress_size
        made.append(entry)
    return made


BOMB = "archive: error: unpacks to {} times its size, as only a zip bomb does"


@pytest.mark.parametrize(
    ("unpacked", "packed", "expected"),
    [
        (256 * MIB, 1, []),  # so much does no harm
        (256 * MIB + 200, MIB, [BOMB.format(256)]),
        (400 * MIB, 2 * MIB, []),
        (400 * MIB + 1, 2 * MIB, [BOMB.format(200)]),
        (300 * MIB, 0, [BOMB.format(300 * MIB)]),
        (4096 * MIB, 30 * MIB, []),
        (4096 * MIB + 1, 30 * MIB, ["archive: error: unpacks to 4.29 GB; at most 4.29 GB are unpacked"]),
    ],
)
def test_what_an_archive_may_unpack_to(unpacked, packed, expected):
    assert told(archive_findings(entries("a", file_size=unpacked, compress_size=packed))) == expected


def test_how_many_files_an_archive_may_hold():
    many = entries(*map(str, range(50_001)))
    assert told(archive_findings(many[1:])) == []
    assert told(archive_findings(many)) == ["archive: error: holds 50001 files; at most 50000 are unpacked"]


OUT = "would be put outside its folder; names must be relative, with '/' and without '..'"
LONG = "has a name that is too long for a file"
DEEP = "/".join(["d" * 99] * 10)  # 999 characters


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a..b/..c/d..", []),
        ("..", [OUT]),
        ("a/..", [OUT]),
        ("", [OUT]),
        ("a\0b", [OUT, "has a name with control characters"]),
        ("x" * 255, []),
        ("x" * 256, [LONG]),
        ("a/" + "x" * 254 + "\u00e4", [LONG]),  # 256 bytes
        ("x" * 200 + "/" + "x" * 200, []),
        (DEEP + "x", []),
        (DEEP + "xx", [LONG]),
    ],
)
def test_names_in_an_archive(name, expected):
    found = [finding.what for finding in archive_findings(entries(name)) if finding.is_error]
    assert found == expected


@pytest.mark.parametrize(
    ("attributes", "n"),
    [
        ({"external_attr": 0o100644 << 16}, 0),
        ({"external_attr": 0o040755 << 16 | 0x10}, 0),
        ({"external_attr": 0o010644 << 16}, 1),
        ({"flag_bits": 0x808}, 0),  # sizes after the content, names in UTF-8
        ({"flag_bits": 0x801}, 1),
        ({"compress_type": ZIP_STORED}, 0),
        ({"compress_type": ZIP_DEFLATED}, 0),
        ({"compress_type": ZIP_BZIP2}, 1),
    ],
    ids=str,
)
def test_kinds_of_entries(attributes, n):
    assert len(told(archive_findings(entries("a", **attributes)))) == n


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a", "a/b/c"], ["'a': error: is a file, but 'a/b/c' is in it"]),
        (["a/b", "a/b/c"], ["'a/b': error: is a file, but 'a/b/c' is in it"]),
        (["a", "a/"], ["'a': error: is a file, but 'a/' is in it"]),
        (["a/", "a/b", "a/c"], []),
        (["a/", "a//b"], []),
        (["./a", "b/./a", "b//c", "./"], []),
        (["a/b", "a//b"], ["'a/b': error: is in the archive 2 times; it is not known which is meant"]),
        (["a", "./a"], ["'a': error: is in the archive 2 times; it is not known which is meant"]),
        (["a", "a"], ["'a': warning: is in the archive 2 times, with the same content; once is enough"]),
    ],
)
def test_names_that_are_one_file(names, expected):
    assert told(archive_findings(entries(*names))) == expected


@pytest.mark.parametrize("other", [{"CRC": 2}, {"file_size": 101}], ids=str)
def test_one_name_of_two_contents(other):
    for changed in (0, 1):
        twice = entries("a", "a")
        for key, value in other.items():
            setattr(twice[changed], key, value)
        assert told(archive_findings(twice)) == [
            "'a': error: is in the archive 2 times; it is not known which is meant"
        ]


@pytest.mark.parametrize(("place", "overlaps"), [(100, True), (129, True), (130, False), (131, False)])
def test_contents_that_share_bytes(place, overlaps):
    """100 bytes behind a header of 30."""
    one, other = entries("a", "b")
    other.header_offset = place
    for order in ([one, other], [other, one]):
        assert told(archive_findings(order)) == (
            ["'a': error: overlaps 'b' in the archive, as in a zip bomb"] * overlaps
        )


def test_how_long_an_xml_file_may_be(monkeypatch):
    monkeypatch.setattr("cosim.fmi.preflight.xml.LARGEST", MIB)
    assert strict_root(b"<a>" + b" " * (MIB - 7) + b"</a>").tag == "a"
    with pytest.raises(ValueError, match="it has 1 MiB; at most 1 MiB are read"):
        strict_root(b"<a>" + b" " * (MIB - 6) + b"</a>")


# The description.

FMI2 = """<fmiModelDescription fmiVersion="2.0" modelName="M" guid="g">
<CoSimulation modelIdentifier="M"/>
<UnitDefinitions><Unit name="m"/><Unit name="s"/></UnitDefinitions>
<TypeDefinitions><SimpleType name="Mass"><Real min="1" max="2" nominal="0"/></SimpleType>
<SimpleType name="Color"><Enumeration><Item name="red" value="1"/></Enumeration></SimpleType></TypeDefinitions>
<ModelVariables>{}</ModelVariables><ModelStructure>{}</ModelStructure></fmiModelDescription>"""
FMI3 = """<fmiModelDescription fmiVersion="3.0" modelName="M" instantiationToken="t">
<CoSimulation modelIdentifier="M"/>
<ModelVariables><Float64 name="t" valueReference="0" causality="independent"/>{}</ModelVariables>
<ModelStructure>{}</ModelStructure></fmiModelDescription>"""


@pytest.fixture
def described(tmp_path):
    """What is told of a description."""

    def tell(text):
        path = tmp_path / "modelDescription.xml"
        path.write_text(text, encoding="utf-8")
        indices = index_findings(strict_root(text.encode())) if 'fmiVersion="2.0"' in text else ()
        findings = (*indices, *description_findings(read_model_description(str(path))))
        return [str(finding).removeprefix("modelDescription.xml: ") for finding in findings]

    return tell


def variable(name, value, **attributes):
    """One of FMI 2.0; by default a parameter with the value reference 0."""
    attributes = {"valueReference": 0, "causality": "parameter", "variability": "fixed"} | attributes
    rest = " ".join(f'{key}="{value}"' for key, value in attributes.items() if value is not None)
    return f'<ScalarVariable name="{name}" {rest}>{value}</ScalarVariable>'


LOCAL = {"causality": "local", "variability": "continuous"}
OUTSIDE = "warning: variable 'v' has the start value {} outside its min {} and max {}"


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ('<Real start="1" min="1" max="2"/>', []),
        ('<Real start="2" min="1" max="2"/>', []),
        ('<Real start="2.5" min="1" max="2"/>', [OUTSIDE.format("2.5", "1", "2")]),
        ('<Real start="7" min="1"/>', []),
        ('<Real start="-7" max="1"/>', []),
        ('<Real start="1" min="1" max="1"/>', []),
        (
            '<Integer start="1" min="3" max="2"/>',
            ["error: variable 'v' has min 3 > max 2", OUTSIDE.format("1", "3", "2")],
        ),
        (
            '<Real start="1" max="NaN"/>',
            ["error: variable 'v' has the max NaN; it must be a number", OUTSIDE.format("1", "-inf", "nan")],
        ),
        ('<Real start="1" nominal="NaN"/>', ["error: variable 'v' has the nominal NaN; it must be a number"]),
        (
            '<Real start="1" nominal="-INF"/>',
            ["warning: variable 'v' has the nominal -inf; it must be finite and not zero"],
        ),
        ('<Real start="1" nominal="-2"/>', []),
        (
            '<Real start="1" min="INF"/>',
            [
                "error: variable 'v' has min inf and max inf, between which there is no number",
                OUTSIDE.format("1", "inf", "inf"),
            ],
        ),
        ('<String start="no number"/>', []),
        ('<Boolean start="true"/>', []),
        (
            '<Real start="3" declaredType="Mass"/>',
            [
                "warning: variable 'v' has the nominal 0; it must be finite and not zero",
                OUTSIDE.format("3", "1", "2"),
            ],
        ),
        ('<Real start="3" declaredType="Mass" max="4" nominal="1"/>', []),
    ],
)  # fmt: skip
def test_numbers(described, value, expected):
    assert described(FMI2.format(variable("v", value), "")) == expected


ONE = variable("one", '<Real start="1" unit="m"/>')
PLAIN = variable("plain", "<Real/>", **LOCAL)
TWO = variable("two", '<Real start="2"/>', initial="exact", **LOCAL)
BOTH_SET = "error: 'one' and 'other' have the value reference 0; only one of such may be set"
APART = "warning: the aliases 'one' and 'two' start as 1 and 2"


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ([ONE, variable("other", '<Real start="1"/>')], [BOTH_SET]),
        ([ONE, variable("other", '<Integer start="1"/>')], []),
        (
            [
                variable("one", '<Integer start="1"/>'),
                variable("other", '<Enumeration declaredType="Color" start="1"/>'),
            ],
            [BOTH_SET],
        ),
        ([ONE, PLAIN], []),
        ([ONE, PLAIN, TWO], [APART]),
        ([PLAIN, ONE, TWO], [APART]),
        ([ONE, variable("fixed", '<Real start="2"/>', causality="local", variability="constant")], []),
        (
            [ONE, variable("other", '<Real unit="s"/>', **LOCAL)],
            ["warning: the aliases 'one' and 'other' have different units"],
        ),
        ([ONE, variable("other", '<Real unit="m"/>', **LOCAL)], []),
    ],
    ids=["two set", "of two types", "integers", "shown", "two starts", "not the first", "constant", "units", "unit"],
)
def test_variables_in_one_place(described, variables, expected):
    assert described(FMI2.format("".join(variables), "")) == expected


STATE = variable("x", '<Real start="1"/>', valueReference=1, initial="exact", **LOCAL)
OUTPUT = variable("y", "<Real/>", valueReference=2, causality="output", variability="continuous")
LISTED = '<Outputs><Unknown index="2"/></Outputs>'


def rates(*references):
    return [variable(f"v{n}", '<Real derivative="1"/>', valueReference=n, **LOCAL) for n in references]


@pytest.mark.parametrize(
    ("variables", "structure", "expected"),
    [
        ([STATE, *rates(2)], "", []),
        ([STATE, *rates(2, 3)], "", ["warning: 'x' has two derivatives: 'v2' and 'v3'"]),
        ([STATE, OUTPUT], LISTED, []),
        (
            [STATE, OUTPUT],
            LISTED.replace("2", "1"),
            [
                "warning: the output 'y' is not in ModelStructure",
                "warning: ModelStructure lists 'x' as an output, which it is not",
            ],
        ),
        ([STATE, OUTPUT], LISTED + LISTED.replace("Outputs", "InitialUnknowns"), []),
    ],
    ids=["derivative", "two derivatives", "output", "no output", "initial output"],
)
def test_structure(described, variables, structure, expected):
    assert described(FMI2.format("".join(variables), structure)) == expected


@pytest.mark.parametrize("kind", ["Outputs", "Derivatives", "InitialUnknowns"])
@pytest.mark.parametrize(("index", "is_there"), [("0", False), ("1", True), ("2", True), ("3", False), ("x", True)])
def test_indices(kind, index, is_there):
    """What is no number the schema refuses, in better words."""
    text = FMI2.format(STATE + OUTPUT, f'<{kind}><Unknown index="{index}"/></{kind}>')
    expected = f"modelDescription.xml: error: {kind} has the index {index}; there are variables 1 to 2"
    assert told(index_findings(strict_root(text.encode()))) == ([] if is_there else [expected])


@pytest.mark.parametrize(
    ("identifier", "kind"),
    [
        ("M", None), ("_m_2", None), ("2M", "warning"), ("M-2", "warning"), ("M.2+b", "warning"),
        ("M\u00e4", "error"), ("", "error"), ("-M", "error"), ("..", "error"), ("a/b", "error"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange", "ScheduledExecution"])
def test_identifiers(described, identifier, kind, interface):
    """What can only be a file's name is a warning: here nothing else is made of it."""
    names = {"ModelExchange": "M", "CoSimulation": "M", "ScheduledExecution": "M"} | {interface: identifier}
    parts = "".join(f'<{part} modelIdentifier="{name}"/>' for part, name in names.items())
    text = FMI3.replace('<CoSimulation modelIdentifier="M"/>', parts)
    told_ = f"{kind}: modelIdentifier {identifier!r} is no C identifier, of letters, digits and '_'"
    told_ += " (FMI 2.0.4, section 4.3.1)" * (kind == "warning")
    assert described(text.format("", "")) == ([told_] if kind else [])


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        ('startTime="0" stopTime="0"', []),
        ('stopTime="-1"', ["warning: DefaultExperiment stops at -1 s, before its start at 0 s"]),
        ('stopTime="INF"', ["warning: DefaultExperiment has the stopTime inf; it must be a finite number"]),
        ('tolerance="NaN"', ["error: DefaultExperiment has the tolerance nan; it must be a finite number"]),
        ('stepSize="0"', ["warning: DefaultExperiment has the stepSize 0; it must be positive"]),
        ('tolerance="-1e-6"', ["warning: DefaultExperiment has the tolerance -1e-06; it must be positive"]),
    ],
)
def test_experiments(described, attributes, expected):
    text = FMI3.format("", "").replace("<ModelVariables>", f"<DefaultExperiment {attributes}/><ModelVariables>")
    assert described(text) == expected


def array(dimensions, start, kind="Float64"):
    """A parameter of FMI 3.0."""
    sizes = "".join(f'<Dimension start="{n}"/>' for n in dimensions)
    value = f'start="{start}"' if kind != "String" else ""
    inside = sizes + "".join(f'<Start value="{text}"/>' for text in start) if kind == "String" else sizes
    return f'<{kind} name="r" valueReference="1" causality="parameter" variability="fixed" {value}>{inside}</{kind}>'


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        (array([999_999], "0"), []),
        (array([1_000, 1_000], "0"), ["error: its arrays have 1000001 elements; at most 1000000 are handled"]),
        (
            array([600_000], "0") + array([600_000], "0").replace('"r" valueReference="1"', '"s" valueReference="2"'),
            ["error: its arrays have 1200001 elements; at most 1000000 are handled"],
        ),
        (array([1], "0"), []),
        (array([3], "7"), []),
        (array([2, 2], "1 2 3 4"), []),
        (array([3], "1 2 3 4"), ["error: variable 'r' has 4 start values; its dimensions [3] need 3 or 1"]),
        (array([2], ["three words here", "one"], "String"), []),
        ('<Float64 name="r" valueReference="1" causality="local"><Dimension start="3"/></Float64>', []),
    ],
    ids=[
        "a million",
        "more",
        "more together",
        "one",
        "one start",
        "two dimensions",
        "four starts",
        "texts",
        "no start",
    ],
)
def test_arrays(described, variables, expected):
    assert described(FMI3.format(variables, "")) == expected


def test_texts_are_told_apart_by_their_elements_not_by_blanks(tmp_path):
    path = tmp_path / "modelDescription.xml"
    path.write_text(FMI3.format(array([2], ["three words here", "one"], "String"), ""), encoding="utf-8")
    variables = scalarized(read_model_description(str(path))).modelVariables
    assert [v.name for v in variables] == ["t", "r[1]", "r[2]"]
    assert variables[1].start == "three words here"


@pytest.mark.parametrize("kind", ["Float32", "Float64"])
@pytest.mark.parametrize(("n_states", "n_rates"), [(0, 0), (3, 3), (3, 2), (0, 3)])
def test_derivatives_of_arrays(described, kind, n_states, n_rates):
    state, rate = (f'<Dimension start="{n}"/>' * (n > 0) for n in (n_states, n_rates))
    text = (
        f'<{kind} name="x" valueReference="1" causality="local" initial="exact" start="1">{state}</{kind}>'
        f'<{kind} name="v" valueReference="2" causality="local" derivative="1">{rate}</{kind}>'
    )
    told_ = ["error: variable 'v' is declared the derivative of 'x', which is of another kind"]
    assert described(FMI3.format(text, "")) == told_ * (n_states != n_rates)


def test_other_names_of_a_variable_are_no_variables_of_their_own(described):
    text = (
        '<Float64 name="x" valueReference="1" causality="local" initial="exact" start="1"/>'
        '<Float64 name="v" valueReference="2" causality="local" derivative="1"><Alias name="speed"/></Float64>'
        '<Float64 name="y" valueReference="3" causality="output"><Alias name="place"/></Float64>'
        '<Float64 name="u" valueReference="4" causality="input" start="0"><Alias name="force"/></Float64>'
    )
    assert described(FMI3.format(text, '<Output valueReference="3"/>')) == []


def test_clocks_and_bytes_have_no_numbers(described):
    text = (
        '<Binary name="b" valueReference="1" causality="parameter" variability="fixed"><Start value="ff"/></Binary>'
        '<Clock name="c" valueReference="2" causality="input" intervalVariability="triggered"/>'
    )
    assert described(FMI3.format(text, "")) == []

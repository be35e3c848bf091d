"""Logs from files: what is read, what is refused in one line, what is passed over with a warning."""

import codecs

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from scipy.io import savemat

from cosim.offline.logs import LogError, read_log
from cosim.unit_text import understood
from cosim.units import conversion

ROWS = {"time": [0.0, 0.1, 0.25], "u": [1.0, 2.0, -3.5e-2]}


@pytest.mark.parametrize(
    ("content", "unit"),
    [
        (b"time,u\n0,1\n0.1,2\n0.25,-3.5e-2\n", None),
        (b"time [s],u [N]\n0.0,1\n0.1,2.0\n0.25,-0.035\n", "N"),
        (b"\xef\xbb\xbftime;u [kN.m]\r\n0;1\r\n0,1;2\r\n0,25;-0,035\r\n", "kN.m"),
        (b'"time"\t"u [\xc2\xb0C]"\n0\t1\n0.1\t2\n0.25\t-0.035\n', "°C"),
        (b"time,u [\xb0C]\n0,1\n0.1,2\n0.25,-0.035\n", "°C"),
        (b"time,u,,\n0,1,,\n0.1,2,,\n0.25,-0.035,,\n", None),
        (codecs.BOM_UTF16_LE + "time\tu [°C]\r\n0\t1\r\n0.1\t2\r\n0.25\t-0.035\r\n".encode("utf-16-le"), "°C"),
        (codecs.BOM_UTF16_BE + "time;u [°C]\n0;1\n0,1;2\n0,25;-0,035\n".encode("utf-16-be"), "°C"),
    ],
    ids=["plain", "units", "decimal-comma", "tabs", "cp1252", "trailing-commas", "utf-16", "utf-16-big-endian"],
)
def test_csv(tmp_path, content, unit):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    log = read_log(path)
    assert {name: c.values.tolist() for name, c in log.columns.items()} == ROWS
    assert log.column("u").unit == unit
    assert log.time_column(None) is log.columns["time"]


def test_missing_cells_are_nan_and_dates_are_seconds(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("when,u\n2026-01-01 12:00:00.00,1\n2026-01-01 12:00:00.25,\n2026-01-01 12:00:01.50,NaN\n")
    log = read_log(path)
    assert log.column("when").values.tolist() == [0.0, 0.25, 1.5]
    assert log.column("when").unit == "s"
    assert np.isnan(log.column("u").values).tolist() == [False, True, True]


def test_parquet_and_mat_hold_the_same(tmp_path):
    pa.parquet.write_table(pa.table(ROWS | {"on": [True, False, True]}), tmp_path / "log.parquet")
    log = read_log(tmp_path / "log.parquet")
    assert log.column("u").values.tolist() == ROWS["u"]
    assert log.column("on").values.tolist() == [1.0, 0.0, 1.0]
    savemat(tmp_path / "log.mat", {"t": ROWS["time"], "rig": {"u": ROWS["u"]}, "y": np.arange(6.0).reshape(3, 2)})
    log = read_log(tmp_path / "log.mat")
    assert log.time_column(None).values.tolist() == ROWS["time"]
    assert log.column("rig.u").values.tolist() == ROWS["u"]
    assert log.column("y(2)").values.tolist() == [1.0, 3.0, 5.0]


@pytest.fixture
def mdf(tmp_path):
    """mdf({group: {channel: (values, times)}}): the path of an MDF4 file."""
    asammdf = pytest.importorskip("asammdf")

    def write(*groups):
        with asammdf.MDF(version="4.10") as file:
            for group in groups:
                file.append([asammdf.Signal(np.array(y), np.array(t), name=n, unit="N") for n, (y, t) in group.items()])
            file.save(tmp_path / "log.mf4")
        return tmp_path / "log.mf4"

    return write


def test_mdf(mdf):
    log = read_log(mdf({"u": (ROWS["u"], ROWS["time"])})).on_one_raster(["u"], [])
    assert log.time_column(None).values.tolist() == ROWS["time"]
    assert (log.column("u").values.tolist(), log.column("u").unit) == (ROWS["u"], "N")


def test_groups_of_an_mdf_file_have_rasters_of_their_own(mdf):
    """An input keeps its value until its next; what is measured is not made up between its samples."""
    fast, slow = [0.0, 0.1, 0.2, 0.3], [0.1, 0.25]
    log = read_log(mdf({"y": ([1.0, 2.0, 3.0, 4.0], fast)}, {"u": ([5.0, 6.0], slow), "v": ([7.0, 8.0], slow)}))
    assert list(log.columns) == ["y", "u", "v"]
    found = log.on_one_raster(["u"], ["y", "v"])
    assert found.time_column(None).values.tolist() == [0.0, 0.1, 0.2, 0.25, 0.3]
    for name, values in {
        "u": [np.nan, 5.0, 5.0, 6.0, 6.0],
        "y": [1.0, 2.0, 3.0, np.nan, 4.0],
        "v": [np.nan, 7.0, np.nan, 8.0, np.nan],
    }.items():
        np.testing.assert_array_equal(found.column(name).values, values)
    assert log.on_one_raster([], ["y"]).time_column(None).values.tolist() == fast  # no stamps of what is not used


def test_a_group_of_an_mdf_file_may_be_empty(mdf):
    log = read_log(mdf({"y": ([1.0], [0.5])}, {"u": ([], [])})).on_one_raster(["u"], ["y"])
    assert np.isnan(log.column("u").values).tolist() == [True]


def test_a_channel_that_two_groups_of_an_mdf_file_have(mdf):
    log = read_log(mdf({"y": ([1.0, 2.0], [0.0, 0.1])}, {"y": ([3.0, 4.0], [0.0, 0.2])}))
    assert log.column("y@1").values.tolist() == [3.0, 4.0]
    with pytest.raises(LogError, match="no column 'y', only y@0, y@1"):
        log.column("y")


def test_what_is_no_mdf_file_is_one_line(tmp_path):
    pytest.importorskip("asammdf")
    (tmp_path / "log.mf4").write_bytes(b"no" * 100)
    with pytest.raises(LogError, match=r"log\.mf4 is no MDF file: ") as refused:
        read_log(tmp_path / "log.mf4")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("log.csv", b"", "is empty"),
        ("log.csv", b"\x7fELF\0\0\0\0", "is no text file"),
        ("log.csv", b"0,1\n0.1,2\n", "must begin with a header that names its columns, got '0,1'"),
        ("log.csv", b"t,u\n0,1\n0.1\n", "cannot be read: CSV parse error: .*Expected 2 columns, got 1"),
        ("log.csv", b"t,u,u [N]\n0,1,1\n", "has two columns 'u'"),
        ("log.csv", codecs.BOM_UTF16_LE + b"\0", "cannot be read"),
        ("log.XLSX", b"PK\3\4", "is a spreadsheet; export it as CSV"),
        ("log.parquet", b"no", "cannot be read"),
        ("log.mat", b"no MAT file at all, and it is long enough to be looked into" * 4, "is no MAT file"),
    ],
)
def test_a_file_that_is_no_log_is_refused_in_one_line(tmp_path, name, content, match):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=match) as refused:
        read_log(tmp_path / name)
    assert "\n" not in str(refused.value)


def test_a_damaged_mat_file_is_refused_in_one_line(tmp_path):
    savemat(tmp_path / "log.mat", ROWS, do_compression=True)
    whole = (tmp_path / "log.mat").read_bytes()
    for damaged in (whole[:150], whole[:-40], whole[:200] + bytes([whole[200] ^ 255]) + whole[201:]):
        (tmp_path / "log.mat").write_bytes(damaged)
        with pytest.raises(LogError, match=r"is no MAT file|cannot be read") as refused:
            read_log(tmp_path / "log.mat")
        assert "\n" not in str(refused.value)


def test_a_decimal_comma_may_come_late(tmp_path):
    rows = [f"{k};{k}" for k in range(60)]
    (tmp_path / "log.csv").write_text("\n".join(["time;u", *rows, "60,5;0,25"]))
    assert read_log(tmp_path / "log.csv").column("u").values[-2:].tolist() == [59.0, 0.25]


def test_numbers_in_another_form_than_those_of_other_columns_are_shown(tmp_path):
    (tmp_path / "log.csv").write_text("time;u;y\n0,5;0,1;0.25\n1,5;0,2;0.5\n")
    with pytest.raises(LogError, match=r"column 'y' must hold numbers, got '0\.25' in row 1 below the header"):
        read_log(tmp_path / "log.csv").column("y")


def test_a_column_of_texts_without_any_is_no_column_of_numbers(tmp_path):
    columns = {"time": pa.array([0.0, 1.0]), "y": pa.array([None, None], pa.string())}
    pyarrow.parquet.write_table(pa.table(columns), tmp_path / "log.parquet")
    with pytest.raises(LogError, match="column 'y' must hold numbers, got 'string'"):
        read_log(tmp_path / "log.parquet").column("y")


def test_a_byte_that_no_code_page_of_windows_has_is_read(tmp_path):
    (tmp_path / "log.csv").write_bytes(b"time,u [\xb0C],note\n0,1,\x81\n0.1,2,b\n0.25,-0.035,c\n")
    assert read_log(tmp_path / "log.csv").column("u").values.tolist() == ROWS["u"]


def test_dates_that_are_no_times_are_refused_only_where_they_are_asked_for(tmp_path):
    until, never = pa.array([None, "9999-12-31"]).cast(pa.date32()), pa.array([None, None], "timestamp[ms]")
    table = {"time": pa.array([0.0, 1.0]), "until": until.cast("timestamp[s]"), "never": never}
    pyarrow.parquet.write_table(pa.table(table), tmp_path / "log.parquet")
    log = read_log(tmp_path / "log.parquet")
    assert log.column("time").values.tolist() == [0.0, 1.0]
    assert np.isnan(log.column("never").values).all()
    with pytest.raises(
        LogError, match="column 'until' must hold numbers, got 'a date that is not within 1678 to 2261'"
    ):
        log.column("until")


def test_the_column_called_time_is_the_time_before_one_called_t(tmp_path):
    """T may be a temperature, and is the first of sorted columns."""
    (tmp_path / "log.csv").write_text("T,time\n20,0\n21,1\n")
    assert read_log(tmp_path / "log.csv").time_name(None) == "time"
    (tmp_path / "log.csv").write_text("T,u\n20,0\n21,1\n")
    assert read_log(tmp_path / "log.csv").time_name(None) == "T"


@pytest.mark.parametrize("cell", ["5_0", "1,234"])
def test_a_cell_that_is_a_number_to_python_or_with_a_comma_is_told_as_it_is(tmp_path, cell):
    (tmp_path / "log.csv").write_text(f'clock,speed\n0,1.5\n1,"{cell}"\n')
    with pytest.raises(LogError, match=f"'speed' must hold numbers, got '{cell}'"):
        read_log(tmp_path / "log.csv").column("speed")


def test_a_row_of_units_is_told_and_what_is_no_number_elsewhere_by_its_row(tmp_path):
    (tmp_path / "log.csv").write_text("time,torque,note,speed\ns,N.m,a,rpm\n0,1,b,1\n1,2,c,\n2,3,d,off\n")
    log = read_log(tmp_path / "log.csv")
    with pytest.raises(LogError) as refused:
        log.column("torque")
    assert str(refused.value).endswith(
        "column 'torque' must hold numbers, got 'N.m' in row 1 below the header; if that row has units, leave it "
        "out, and name the column 'torque [N.m]'."
    )
    for name in ("note", "speed"):
        with pytest.raises(LogError, match=r"got '\w+' in row 1 below the header\.$"):
            log.column(name)
    (tmp_path / "log.csv").write_text("time,torque\n0,1\n1,\n2,oops\n")
    with pytest.raises(LogError, match=r"got 'oops' in row 3 below the header\.$"):
        read_log(tmp_path / "log.csv").column("torque")


def test_columns_that_are_not_there_or_no_numbers(tmp_path):
    (tmp_path / "log.csv").write_text("clock,speed\n0,fast\n1,2\n")
    log = read_log(tmp_path / "log.csv")
    with pytest.raises(LogError, match="'speed' must hold numbers, got 'fast'"):
        log.column("speed")
    with pytest.raises(LogError, match="no column 'sped'; did you mean 'speed'"):
        log.column("sped")
    with pytest.raises(LogError, match="no column 'time' or 't'; give --time"):
        log.time_column(None)
    with pytest.raises(LogError, match=r"none\.csv cannot be read: No such file"):
        read_log(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("text", "si", "value"),
    [  # by the SI brochure (2019) and the definitions of the other units
        ("deg", "rad", 0.017453292519943295),
        ("rpm", "rad/s", 0.10471975511965977),
        ("km/h", "m/s", 0.2777777777777778),
        ("kN", "kg.m/s2", 1000.0),
        ("N.m", "kg.m2/s2", 1.0),
        ("Nm", "J", 1.0),
        ("mm", "m", 1e-3),
        ("g.cm2", "kg.m2", 1e-7),
        ("deg/s^2", "rad/s2", 0.017453292519943295),
        ("bar", "Pa", 1e5),
        ("min", "s", 60.0),
        ("%", "1", 0.01),
        ("mV", "kg.m2.s-3.A-1", 1e-3),
        ("l/min", "m3/s", 1e-3 / 60.0),
    ],
)
def test_units(text, si, value):
    convert = conversion(understood(text), understood(si))
    assert convert(1.0) == pytest.approx(value, rel=1e-14)
    assert convert(0.0) == 0.0


def test_temperatures_have_an_offset_and_unknown_units_no_definition():
    assert conversion(understood("degC"), understood("K"))(20.0) == pytest.approx(293.15)
    assert conversion(understood("degF"), understood("degC"))(212.0) == pytest.approx(100.0)
    assert understood("furlong").exponents is None
    assert understood("Hz").exponents is None  # a cycle or a radian?

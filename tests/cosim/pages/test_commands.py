"""`retune report` and `retune plot`: what they write, and what they refuse."""

import pytest

pytestmark = pytest.mark.usefixtures("workplace")


@pytest.mark.full
@pytest.mark.fmu
def test_a_report_is_written_into_the_run_folder_and_never_over_a_file(called, recorded, workplace):
    page = recorded / "report.html"
    page.unlink(missing_ok=True)
    assert called("report", recorded) == (0, f"{page}\n", "")
    code, out, err = called("report", recorded)
    assert (code, out) == (2, "")
    assert "report.html exists; give --out a new file" in err
    page.write_text("mine")
    assert called("report", recorded, "--force")[0] == 0
    assert page.read_text().startswith("<!DOCTYPE html>")
    assert called("report", recorded, recorded / "none", "-o", "both.html")[:2] == (0, "both.html\n")
    assert called("plot", recorded, recorded / "none")[:2] == (0, "plot.png\n")
    assert called("plot", recorded, "-o", "one.svg")[:2] == (0, "one.svg\n")
    assert {p.name for p in workplace.iterdir()} == {"both.html", "plot.png", "one.svg"}


@pytest.mark.full
@pytest.mark.fmu
def test_a_folder_of_many_runs_becomes_a_list_with_links(called, recorded, workplace):
    for k in range(9):
        (workplace / "all" / f"run {k}").mkdir(parents=True)
        for name in ("manifest.json", "result.json"):
            (workplace / "all" / f"run {k}" / name).write_bytes((recorded / name).read_bytes())
    (workplace / "all" / "run 3" / "report.html").write_text("there")
    assert called("report", "all")[0] == 0
    text = (workplace / "all" / "report.html").read_text()
    assert "</span> of 9 runs" in text
    assert 'href="run%203/report.html"' in text
    assert 'href="run%204"' in text


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["report", "gone"], "gone is no run folder, nor a folder of runs: No such file"),
        (["report", "."], ". holds no run: neither manifest.json nor folders with one"),
        (["report", "gone", "-o", "gone/page.html"], "gone/page.html is in no folder that there is"),
        (["plot", "."], ". is no run folder: cannot read manifest.json"),
        (["plot", ".", "-o", "picture.pdf"], "picture.pdf must end in .png or .svg"),
        (["plot", *"123456789"], "a picture has room for 8 runs, got 9"),
        (["report"], "the following arguments are required: RUN"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_nothing_is_written(called, workplace, arguments, told):
    code, out, err = called(*arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert told in err
    assert list(workplace.iterdir()) == []

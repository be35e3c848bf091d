"""What Python users see: a run on axes, in a notebook and as a Dataset; beliefs and surrogates."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from cosim import plot_belief, plot_surrogate
from cosim.runs.final_estimate import FinalEstimate
from estimator import Parameter, ParameterSpace, TargetVector
from tests.cosim.plots.made_up import made_up_run

SPACE = ParameterSpace((Parameter("k", 0.1, 100.0, "N/m", "log"), Parameter("c", -1.0, 1.0, "kg/s", "linear")))


@pytest.fixture
def told():
    """An estimator that has been told a residual whose least square is at k = 4, c = 0.25."""
    estimator = TargetVector(SPACE, start=np.array([1.0, 0.0]), rng=np.random.default_rng(0))
    for _ in range(12):
        theta = estimator.ask()
        estimator.tell(theta, np.array([10.0 * np.log(theta[0] / 4.0), 20.0 * (theta[1] - 0.25), 0.1]))
    return estimator


def test_a_belief_has_its_peak_at_the_estimate_and_its_width_is_the_standard_deviation(told):
    estimate, axes = told.estimate(), Figure().subplots(1, 2)
    assert plot_belief(estimate, SPACE, axes) is axes
    for i, place in enumerate(axes):
        x, density = place.lines[0].get_data()
        z, width = (np.log(x), estimate.std[i] / estimate.theta[i]) if i == 0 else (x, estimate.std[i])
        assert x[np.argmax(density)] == pytest.approx(estimate.theta[i], rel=1e-9)
        half = z[density > np.exp(-0.5)]
        assert half[-1] - half[0] == pytest.approx(2.0 * width, rel=0.05)


def test_what_the_data_do_not_determine_is_dashed_and_the_truth_is_there():
    last = FinalEstimate(0.4, ("m", "l"), ("kg", "m"), (1.0, 0.7), (0.1, 0.5), (True, False), ())
    run = made_up_run(None, final_estimate=last)
    one, other = plot_belief(run, axes=list(Figure().subplots(1, 2)))
    assert (one.lines[0].get_linestyle(), other.lines[0].get_linestyle()) == ("-", "--")
    assert one.lines[1].get_xdata()[0] == run["plant.m"][40]
    with pytest.raises(ValueError, match="nothing was estimated"):
        plot_belief(made_up_run(None))
    with pytest.raises(ValueError, match="needs its ParameterSpace"):
        plot_belief(last)
    with pytest.raises(ValueError, match="2 parameters need as many axes, got 1"):
        plot_belief(run, axes=one)


def test_a_surrogate_is_what_gpy_predicts_along_each_parameter(told):
    axes = Figure().subplots(1, 2)
    assert plot_surrogate(told, SPACE, axes) is axes
    z = SPACE.to_unit(told.estimate().theta)
    x, drawn = axes[1].lines[0].get_data()
    places = np.column_stack([np.full(len(x), z[0]), [SPACE.to_unit(np.array([4.0, c]))[1] for c in x]])
    np.testing.assert_allclose(drawn, told.model.predict(places)[0][:, 0], rtol=1e-6, atol=1e-9)


@pytest.mark.full
def test_a_run_is_a_dataset_with_units():
    pytest.importorskip("xarray")
    made_up = made_up_run(None)
    table = made_up.to_xarray()
    np.testing.assert_array_equal(table["plant.phi"], made_up["plant.phi"])
    np.testing.assert_array_equal(table["time"], made_up.time)
    assert table["controller.m"].attrs == {"units": "kg", "long_name": "m in the controller"}
    assert table["plant.m"].attrs == {"units": "kg", "long_name": "true m"}
    assert table["time"].attrs["units"] == "s"
    assert table.attrs["estimator"] == "target"
    assert table.attrs["mean_squared_error"] == made_up.mse


def test_a_run_shows_itself_as_a_table_of_escaped_text():
    html = made_up_run(None, estimator="<b>mine</b>")._repr_html_()
    assert "&lt;b&gt;mine" in html
    assert "<b>mine" not in html
    assert "plant.phi" in html
    assert "m [kg]" in html
    assert "<script" not in html


def test_a_run_is_plotted_in_a_figure_of_its_own():
    from matplotlib import pyplot

    axes = made_up_run(None).plot()
    assert [place.get_ylabel() for place in axes] == [r"$\phi$", "$u$", "$m$ [kg]", "$l$ [m]"]
    pyplot.close("all")

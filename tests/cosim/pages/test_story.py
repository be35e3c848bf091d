"""What a reader is told of a run: each sentence and row against a record whose content is known."""

from typing import get_args, get_type_hints

import numpy as np
import pytest

from cosim.pages.marks import REFUSALS, SIGNS, reason_of, refusals
from cosim.pages.plant_changes import plant_changes
from cosim.pages.story import chapters, verdict
from cosim.runs.quantities import disturbance_sizes, uncertainty_band
from estimator.events import Event

NOTICED = {"t": 0.52, "kind": "trigger", "reason": "normalised innovation squared 50 exceeds 24"}
WRITTEN = {"t": 0.55, "kind": "write", "theta": [2.01, 0.75], "std": [0.02, 0.01], "reason": "incumbent"}

WEIGHED = {
    "t": 0.61, "kind": "evidence", "n_samples": 5, "explained": ["disturbance"],
    "scores": {"parameters": None, "disturbance": 20.0, "nothing": 60.0, "some other": 1.0},
}  # fmt: skip


def test_a_change_is_told_with_the_time_until_it_was_noticed_written_and_found(made_up):
    shown = made_up(events=[NOTICED, WRITTEN])
    (row,) = plant_changes(shown.run, shown.events)
    assert row == ("0.5 s", "m: 1 → 2", "after 20 ms", "changed parameters", "after 50 ms", "after 70 ms")
    named = [NOTICED, {"t": 0.57, "kind": "disturbance", "size": {"plant.der(phi_dot)": 2.0}, "reason": "constant"}]
    (row,) = plant_changes(shown.run, named)
    assert row[2:5] == ("after 20 ms", "a disturbance after 70 ms", "-")


@pytest.mark.parametrize(
    ("kind", "noticed"), [("candidate", "a search was under way"), ("end", "after 20 ms"), ("lag", "after 20 ms")]
)
def test_a_search_that_something_else_has_ended_is_not_under_way(made_up, kind, noticed):
    before = [{"t": 0.2, "kind": "trigger", "reason": ""}, {"t": 0.3, "kind": kind, "time_constant": 0.03}]
    shown = made_up(events=[*before, NOTICED, WRITTEN])
    (row,) = plant_changes(shown.run, shown.events)
    assert row.noticed == noticed


def test_a_gust_is_told_from_where_it_begins_to_where_it_ends(made_up):
    t = 0.01 * np.arange(100)
    gust = np.where((t >= 0.3) & (t <= 0.6), 1.0 - np.cos(2.0 * np.pi * (t - 0.3) / 0.3), 0.0)
    shown = made_up(plant_m=1.0 + gust, controller_m=[1.0] * 100, events=[NOTICED])
    (row,) = plant_changes(shown.run, shown.events)
    assert row[:3] == ("0.3 s", "m drifts between 1 and 3 until 0.6 s", "after 220 ms")


def test_parameters_that_are_wrong_at_first_and_those_that_drift_are_told(made_up):
    drift = 1.0 + 0.001 * np.arange(100)
    shown = made_up(plant_m=drift, controller_m=np.full(100, 3.0))
    (row,) = plant_changes(shown.run, ())
    assert row[:3] == ("at the start", "m is 1, the controller has 3; m drifts between 1 and 1.099", "-")


@pytest.mark.parametrize(
    ("held", "told"),
    [
        ([1.0] * 50 + [2.0] * 50, "right throughout"),
        ([1.0] * 53 + [2.0] * 47, "after 30 ms"),
        ([1.0] * 53 + [2.0] * 7 + [9.0] * 10 + [2.0] * 30, "after 200 ms"),
        ([1.0] * 53 + [2.0] * 7 + [9.0] * 40, "after 30 ms, lost after 100 ms"),
        ([1.0] * 50 + [2.0] * 10 + [9.0] * 40, "right, lost after 100 ms"),
        ([1.0] * 50 + [9.0] * 50, "-"),
    ],
)
def test_parameters_are_right_from_when_they_stay_so(made_up, held, told):
    shown = made_up(plant_m=[1.0] * 50 + [2.0] * 50, controller_m=held)
    (row,) = plant_changes(shown.run, ())
    assert row[-1] == told


def test_nothing_is_told_of_a_plant_that_does_not_change(made_up):
    shown = made_up(plant_m=[1.0] * 100, controller_m=[1.0] * 100)
    assert plant_changes(shown.run, ()) == []


def test_the_verdict_compares_with_nominal_and_true_parameters_and_counts(made_up, changed):
    shown = made_up(
        plant_phi=np.cos(0.01 * np.arange(100)) + 0.1, events=[NOTICED, WRITTEN, {"t": 0.6, "kind": "veto"}]
    )
    worse = made_up(plant_phi=np.cos(0.01 * np.arange(100)) + 1.0).run
    better = made_up(plant_phi=np.cos(0.01 * np.arange(100)) + 0.05).run
    told = verdict(shown.run, {"none": worse, "true": better}, shown.events)
    assert told == [
        "Re-tuning by target kept the loop to its end at t = 0.99 s.",
        "Its mean squared tracking error is 1/100 of the nominal controller's and 4 times that of a controller with "
        "the true parameters.",
        "It was triggered once and wrote parameters once; the guard refused 1 write and reverted 0; 0 disturbances "
        "were named.",
    ]
    told = verdict(shown.run, {"none": shown.run}, ())
    assert told[1:] == [
        "Its mean squared tracking error is equal to the nominal controller's.",
        "It was never triggered and wrote no parameters; the guard refused 0 writes and reverted 0; 0 disturbances "
        "were named.",
    ]
    lost = changed(shown, status="diverged").run
    assert verdict(lost, {"none": worse}, ())[:1] == [
        "The loop was lost with re-tuning by target: at t = 0.99 s a tracked error passed the limit of divergence."
    ]


def test_what_was_refused_is_told_with_its_reason_the_same_ones_together(made_up):
    veto = "predicted peak of the tracking error {}, without the write {} (estimate)"
    events = [
        {"t": 0.4, "kind": "undo", "theta": [1.0, 0.75], "reason": "a constant disturbance"},
        {"t": 0.4, "kind": "disturbance", "size": {"plant.der(phi_dot)": 2.0}, "reason": "a constant disturbance"},
        {"t": 0.5, "kind": "veto", "reason": veto.format("0.2", "1e-05")},
        {"t": 0.6, "kind": "veto", "reason": veto.format("0.3", "0.1")},
        {"t": 0.7, "kind": "observation", "fault": "stuck", "sensor": "plant.phi"},
    ]
    shown = made_up(events=events)
    assert refusals(shown.run, shown.events) == [
        ("refused by the guard", veto.format("0.2", "1e-05"), "2 times, 0.5 to 0.6 s"),
        ("sample kept out", "plant.phi: stuck", "0.7 s"),
        ("undone", "a constant disturbance; back to m 1 kg, l 0.75 m", "0.4 s"),
    ]


def test_a_search_is_told_from_its_trigger_to_the_next(made_up):
    events = [NOTICED, {"t": 0.53, "kind": "candidate"}, WRITTEN, {"t": 0.6, "kind": "veto"}]
    events += [WEIGHED, {"t": 0.7, "kind": "disturbance", "size": {}, "reason": "over"}, NOTICED | {"t": 0.8}]
    shown = made_up(events=events)
    first, second = chapters(shown.run, shown.events)
    assert first == (
        0.52,
        NOTICED["reason"],
        1,
        '"a disturbance acts" explains the newest 5 samples; worse: nothing has changed (by 40)',
        "1 write, the last: m 2.010 ± 0.020 kg, l 0.750 ± 0.010 m",
        "refused once, a disturbance over once",
    )
    assert second == (0.8, NOTICED["reason"], 0, "", "nothing", "")


RUBBED = {
    "t": 0.6, "kind": "friction", "reason": "friction that the model lacks",
    "terms": [{"law": "dry", "coefficient": 0.125, "acts_on": "plant.u", "speed_of": "plant.der(phi_dot)"}],
}  # fmt: skip


def test_friction_is_told_with_its_size_and_its_end_is_not_taken_for_another_one(made_up):
    over = RUBBED | {"t": 0.8, "terms": [], "reason": "the friction is over"}
    shown = made_up(events=[NOTICED, RUBBED, NOTICED | {"t": 0.7}, over])
    assert reason_of(shown.events[1], shown.run) == (
        "friction that the model lacks; dry on plant.u, 0.125 against the speed whose derivative is plant.der(phi_dot)"
    )
    told = verdict(shown.run, {}, shown.events)[-1]
    assert told.endswith("were named; friction that the model lacks was named once.")
    assert [c.refused for c in chapters(shown.run, shown.events)] == ["friction named once", "friction over once"]
    late = made_up(events=[NOTICED, over])
    assert plant_changes(late.run, late.events)[0].taken_for == "-"


def test_inputs_that_arrive_late_are_told_with_their_lag(made_up):
    late = {"t": 0.6, "kind": "lag", "time_constant": 0.03, "dead_time": 0.0, "reason": "late"}
    shown = made_up(events=[NOTICED, late, late | {"t": 0.7, "time_constant": 0.0, "reason": "in time"}])
    assert [reason_of(e, shown.run) for e in shown.events[1:]] == ["late; time constant 0.03 s", "in time"]
    refused = "late or limited inputs named once, inputs as sent again once"
    assert chapters(shown.run, shown.events)[0].refused == refused
    limited = {"t": 0.6, "kind": "lag", "time_constant": 0.0, "dead_time": 0.0, "rates": [None, 2.5], "reason": "late"}
    slow = made_up(events=[NOTICED, limited, limited | {"t": 0.7, "rates": [None, None], "reason": "in time"}])
    assert [reason_of(e, slow.run) for e in slow.events[1:]] == ["late; rate limited to 2.5 per second", "in time"]
    assert chapters(slow.run, slow.events)[0].refused == refused


def test_a_disturbance_that_has_passed_is_known_for_a_step_and_one_that_acts_until_its_end(made_up):
    acting = {"t": 0.1, "kind": "disturbance", "size": {"plant.phi": 2.0}, "is_known": True}
    over, passed = acting | {"t": 0.2, "size": {}}, acting | {"t": 0.3, "size": {"plant.phi": 5.0}, "is_known": False}
    shown = made_up(events=[acting, over, passed])
    (of,) = disturbance_sizes(shown.run, shown.events).values()
    at = [list(of.values())[np.searchsorted([*of], t, side="right") - 1] for t in (0.05, 0.15, 0.25, 0.305, 0.32, 0.49)]
    assert at == [0.0, 2.0, 0.0, 5.0, 0.0, 0.0]


def test_the_band_of_what_was_written_ends_where_earlier_parameters_return(made_up):
    back = {"t": 0.7, "kind": "undo", "theta": [1.0, 0.75], "reason": "friction"}
    shown = made_up(events=[WRITTEN, back])
    band = uncertainty_band(shown.run, "m", shown.events)
    np.testing.assert_allclose(band.t[:2], [0.55, 0.7])
    assert band.low[0] < 2.0 < band.high[0]
    assert list(band.low[1:]) == list(band.high[1:]) == [1.0, 1.0]


def test_every_kind_of_event_has_a_sign():
    kinds = {*get_args(get_type_hints(Event)["kind"]), "fault", "interrupt"}
    assert kinds - {"candidate", "evidence"} == {*SIGNS}  # which have pictures of their own
    assert {*REFUSALS} <= kinds
    assert (
        len({sign.text for sign in SIGNS.values()}) == len({sign.marker for sign in SIGNS.values()} | {"again"}) == 20
    )

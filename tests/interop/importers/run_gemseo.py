"""gemseo-fmu: a TimeSteppingSystem."""

import logging

from gemseo_fmu.disciplines.do_step_fmu_discipline import DoStepFMUDiscipline
from gemseo_fmu.disciplines.time_stepping_system import TimeSteppingSystem
from gemseo_fmu.utils.time_series import TimeSeries
from jobs import Job, run
from numpy import array


def simulate(job: Job) -> list[list[float]]:
    h, stop_time = job.macro_step, job.n_steps * job.macro_step
    read = {name: name for name in (*job.outputs, *job.connections.values())}
    disciplines = []
    options = dict(job.options)
    lag, is_function = options.pop("lag", 0.5), options.pop("is_function", False)
    for component in options.pop("order", list(job.fmus)):
        given = {name: name for name in (*job.start, *job.changed())} | job.connections
        inputs, outputs = job.of(component, given), job.of(component, read)
        disciplines.append(
            DoStepFMUDiscipline(
                job.fmus[component],
                name=component,
                input_names=list(inputs) or None,
                output_names=list(outputs),
                variable_names=inputs | outputs,
                initial_time=0.0,
                final_time=stop_time,
                time_step=h,
            )
        )
        for variable, value in job.of(component, job.start).items():
            disciplines[-1].io.input_grammar.defaults[inputs[variable]] = array([value])
    system = TimeSteppingSystem(disciplines, stop_time, h, **options)
    series = {}
    for name in job.changed():
        points = {0.0: job.start[name]}
        for k, change in job.changes.items():
            # A time series is evaluated at the end of a step: what is to act from t_k on has to come half a step later.
            points |= {(int(k) + lag) * h: change[name]} if name in change else {}
        series[name] = TimeSeries(list(points), list(points.values()))
        if is_function:  # of the time: what a feedback from outside would be
            series[name] = series[name].compute
    results = system.execute(series)
    return [[float(x) for x in row] for row in zip(*(results[name] for name in job.outputs))]


logging.disable(logging.WARNING)  # its residuals are those of an iteration, which a single sweep is not
run(simulate)

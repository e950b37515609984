"""What the library's door refuses, before any work, and in which words."""

import pickle
import warnings
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import pytest
from IPython.core.interactiveshell import InteractiveShell

import tulip_testbed as tt
from tulip_testbed.base.arguments import checked
from tulip_testbed.base.errors import InputError, InputWarning, choices, listed, look_up

DOUBTFUL = "cell-gain:right.front_left=3"


@checked
def asked(
    count: int, size: float | None = None, names: Sequence[str | float] | str = (), *more: bool
) -> tuple:
    return count, size, names, more


@checked
def chosen(engine: Literal["statics", "dynamics"], pair: tuple[float, float] | None = None) -> tuple:
    return engine, pair


@pytest.mark.parametrize(
    ("call", "given", "message"),
    [
        (asked, (1.5,), "count: found the float 1.5, expected a whole number"),
        (asked, (True,), "count: found the bool True, expected a whole number"),
        (asked, ("10",), "count: found the str '10', expected a whole number"),
        (asked, (1, "2"), "size: found the str '2', expected a number or None"),
        (asked, (1, 2, {}), "names: found dict, expected a list of them or a text"),
        (asked, (1, 2, ["a", None]), r"names\[1\]: found None, expected a text or a number"),
        (asked, (1, 2, "a", True, 0), "more: found the int 0, expected True or False"),
        (chosen, ("static",), "engine: found the str 'static', expected 'statics' or 'dynamics'"),
        (chosen, ("statics", 3), "pair: found the int 3, expected a tuple of them or None"),
        (chosen, ("statics", (1.0, "2")), r"pair\[1\]: found the str '2', expected a number"),
        (chosen, ("statics", (1.0,)), r"pair\[1\]: found tuple, expected more values"),
    ],
)
def test_an_argument_of_another_type_is_refused(call, given, message):
    with pytest.raises(InputError, match=f"^{message}$"):
        call(*given)


def test_what_fits_passes_and_numbers_of_numpy_become_plain():
    assert chosen("statics", (np.float64(1), 2)) == ("statics", (1.0, 2.0))
    assert asked(1, 2, ["a", 0.5], True) == (1, 2, ["a", 0.5], (True,))
    count: Any = np.int64(3)
    assert type(asked(count)[0]) is int
    with pytest.raises(TypeError, match="count"):
        asked()  # type: ignore[missing-argument]  # as Python says it


def test_measurements_come_from_a_folder_or_a_run_too(run, tmp_path):
    tt.write_measurements(tmp_path / "data", run.measurements)
    given = (run.measurements, run, tmp_path / "data")
    values = [tt.identify(m, estimator="mixed-model").full.value for m in given]
    assert np.array_equal(values[0], values[1])
    assert np.array_equal(values[0], values[2])
    assert tt.check(run).verdict == tt.check(run.measurements).verdict


def test_a_laboratory_reads_texts(robot):
    text = "cell-gain:right.front_left=0.03"
    expected = tt.Laboratory(robot).with_effects(text)
    laboratory: Any = tt.Laboratory  # type checkers know the attributes that it will have
    assert laboratory(robot, hidden=(text,)) == expected
    assert laboratory(robot, hidden=text) == expected


@pytest.mark.parametrize(
    "call",
    [
        f"lab.with_effects('{DOUBTFUL}')",
        f"lab.with_known(tt.effects.parse('{DOUBTFUL}', lab.robot))",
        f"tt.Laboratory(lab.robot, hidden=('{DOUBTFUL}',))",
        f"tt.check(run, corrections='{DOUBTFUL}')",
    ],
)
def test_an_implausible_value_warns_at_the_line_that_called(call, run):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        exec(f"\n\n{call}", {"__name__": "notebook", "tt": tt, "run": run, "lab": run.laboratory})
    (warning,) = seen
    assert (warning.category, warning.filename, warning.lineno) == (InputWarning, "<string>", 3)
    assert str(warning.message) == (
        "cell-gain:right.front_left: gain 3 (300 %) is 60 times what is plausible (0.05); "
        "values are in SI units"
    )


def test_close_names_come_first():
    assert (
        choices("right_kne", ["left_hip", "right_knee"])
        == "did you mean 'right_knee'? valid: left_hip, right_knee"
    )
    assert choices("zzz", ["left_hip"]) == "valid: left_hip"
    assert listed(range(1000)).endswith("38, 39 and 960 more")
    with pytest.raises(KeyError):  # so that mappings may raise it
        look_up("joint", "knee", ["hip"], "plan")


def test_a_notebook_shows_the_line_and_the_message(capsys):
    shell = InteractiveShell()
    shell.run_cell("import tulip_testbed as tt\nplan = 3\ntt.plans.write('folder', plan)")
    out = capsys.readouterr().out
    assert out.splitlines() == [
        "----> 3 tt.plans.write('folder', plan)",
        "InputError: plan: found the int 3, expected PosturePlan",
    ]
    assert str(pickle.loads(pickle.dumps(InputError("as it was")))) == "as it was"


def test_results_are_pickled_and_compared(robot, two):
    run = tt.Laboratory(robot).with_effects("cell-gain:right.front_left=0.03").run(two, engine="statics")
    again = pickle.loads(pickle.dumps(run))
    assert str(again.laboratory.hidden[0]) == str(run.laboratory.hidden[0])
    assert np.array_equal(again.measurements.cell_forces, run.measurements.cell_forces)
    assert run == run
    assert run != again
    assert len({run, again}) == 2

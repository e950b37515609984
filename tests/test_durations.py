"""The default suite takes a few minutes: its recorded processor time is limited, the record is current."""

from tests.durations import OUTSIDE, default_tests, read_durations

MOST = 8 * 60  # s of processor time, half of it on each of two cores
STALE = 0.05  # of the tests may be new or gone since the record was made


def test_the_default_suite_takes_eight_minutes_of_a_processor_at_most():
    durations = read_durations()
    assert sum(durations.values()) <= MOST, "make tests cheaper or mark them slow, then `make durations`"


def test_the_record_of_durations_is_current():
    recorded, present = set(read_durations()) - {OUTSIDE}, default_tests()
    new, gone = sorted(present - recorded), sorted(recorded - present)
    assert len(new) <= STALE * len(present), f"not recorded, run `make durations`: {new[:10]} ..."
    assert len(gone) <= STALE * len(present), f"recorded, but gone, run `make durations`: {gone[:10]} ..."

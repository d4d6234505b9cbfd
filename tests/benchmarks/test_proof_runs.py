"""A careless test finds no fault, one that always accuses has nothing but false alarms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from benchmarks.proof.figures import (
    Counts,
    draw_shifts,
    fault_figures,
    fault_table,
    healthy_figures,
    shift_curve,
    upper_end,
    worst_camera,
)
from benchmarks.proof.runs import BUNDLES, Job, Kind, Preparation, Tally, run, tallied
from benchmarks.proof.world import Extent, World
from scipy.stats import binom

from veilcam_optics.keys.masks import Levels
from veilcam_optics.proof import PROOF, Finding, Verdict
from veilcam_server.demo_data import FRESH, load_digits
from veilcam_training.bundle import read_bundle

EXTENT = Extent(masks=2, captures=6, objects=2, surroundings=2)


class Always:
    """A test that does not look."""

    def __init__(self, verdict: Verdict) -> None:
        self._verdict = verdict
        self.prepared: list[bytes] = []

    def prepare(self, levels: Levels) -> Always:
        self.prepared.append(levels.tobytes())
        return self

    def find_each(
        self,
        measurements: npt.NDArray[np.float32],
        clipped: npt.NDArray[np.bool_],
        before: Sequence[Always],
    ) -> list[Finding]:
        assert len(before) == 2
        assert measurements.shape == clipped.shape == (len(clipped), *PROOF.shape)
        return [
            Finding(self._verdict, float(each.mean()), "another", 1.0, 1.0) for each in measurements
        ]


def careless(world: World) -> Preparation[Always]:
    return Always("seen")


def accusing(world: World) -> Preparation[Always]:
    return Always("not seen")


def _jobs(kind: Kind) -> list[Job]:
    return [Job(kind, bundle, 7, 0, EXTENT) for bundle in BUNDLES]


@pytest.mark.slow
def test_a_careless_test_finds_nothing(tmp_path: Path) -> None:
    tallies = run(tmp_path, _jobs("faulty"), careless, 1)
    figures = fault_figures(fault_table(tallies))
    assert figures["fault_found_first_capture"] == 0
    assert figures["fault_seen_first_capture"] == 1
    assert figures["fault_captures"] == 2 * 2 * 6 * 6  # bundles, masks, captures, faults
    assert healthy_figures(run(tmp_path, _jobs("healthy"), careless, 1))["false_alarms"] == 0


@pytest.mark.slow
def test_a_test_that_always_accuses_has_nothing_but_false_alarms(tmp_path: Path) -> None:
    figures = healthy_figures(run(tmp_path, _jobs("healthy"), accusing, 1))
    assert figures["healthy_captures"] == figures["false_alarms"] == 24
    assert figures["false_alarms_upper95"] == 1
    assert figures["cameras"] == 2
    tallies = run(tmp_path, _jobs("faulty"), accusing, 1)
    assert fault_figures(fault_table(tallies))["fault_found_first_capture"] == 1
    lines, counts = shift_curve(tallies, "rows", "dim")
    assert lines == [-3, -2, -1, 1, 2, 3]
    assert all(each.accused == each.captures == 8 for each in counts)
    draw_shifts(tallies, tmp_path / "shifts.png")
    assert (tmp_path / "shifts.png").stat().st_size > 0


@pytest.mark.slow
def test_a_run_goes_on_where_it_was_and_mixes_with_no_other(tmp_path: Path) -> None:
    jobs = _jobs("healthy")
    first = run(tmp_path, jobs[:1], careless, 1)
    both = run(tmp_path, jobs, accusing, 1)
    # The first camera was not looked at again.
    assert [Counts.of([tally], "healthy", ["dim"]).seen for tally in both] == [4, 0]
    assert both[0] == first[0]
    with pytest.raises(ValueError, match="another run"):
        run(tmp_path, [replace(jobs[0], extent=replace(EXTENT, captures=9))], careless, 1)


@pytest.mark.slow
def test_processes_count_what_one_does(tmp_path: Path) -> None:
    jobs = _jobs("healthy")
    alone = run(tmp_path / "alone", jobs, careless, 1)
    assert run(tmp_path / "together", jobs, careless, 2) == alone


@pytest.mark.slow
def test_a_mask_is_tested_with_the_one_before_it_and_prepared_once() -> None:
    world = World(read_bundle(FRESH), load_digits(), 5, EXTENT)
    tests = Always("seen")
    tallied(world.faulty(), tests, _jobs("faulty")[0])
    shown = [mask.tobytes() for mask in world.masks]
    assert tests.prepared == shown


def _tally(number: int, margin: float, accused: int) -> Tally:
    tally = Tally({"number": number}, least_margin={"healthy/dim": margin})
    tally.verdicts["healthy/dim/not seen"] = accused
    return tally


def test_the_worst_camera_is_the_one_that_is_accused_most_or_nearly_was() -> None:
    tallies = [_tally(1, 5.0, 0), _tally(2, 3.0, 0), _tally(3, 9.0, 0)]
    assert worst_camera(tallies).job["number"] == 2
    assert worst_camera([*tallies, _tally(4, 20.0, 1)]).job["number"] == 4


def test_the_upper_end_is_where_so_few_events_are_that_unlikely() -> None:
    assert upper_end(0, 1_000_000) == pytest.approx(3.69e-6, rel=1e-2)
    for events, trials in ((0, 100), (3, 1000), (40, 50)):
        assert binom.cdf(events, trials, upper_end(events, trials)) == pytest.approx(0.025)
    assert upper_end(5, 5) == 1

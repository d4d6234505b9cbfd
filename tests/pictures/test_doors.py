"""Pictures of every format and defect, by every door that takes pictures."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from tests.pictures.doors import DOORS, Doors, open_doors
from tests.pictures.samples import Sample, levels, make_samples

SAMPLES = make_samples()


@pytest.fixture(scope="module")
def doors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Doors]:
    with open_doors(tmp_path_factory.mktemp("doors")) as opened:
        yield opened


@pytest.mark.thorough
@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: sample.name)
def test_picture_is_read_or_refused_by_name(doors: Doors, sample: Sample, door: str) -> None:
    found = doors(door, sample.name, sample.content)
    if sample.refusal:
        assert isinstance(found, str)
        assert re.search(sample.refusal, found)
        assert not found.startswith("UNNAMED")
        return
    assert not isinstance(found, str), found
    assert levels(found) == pytest.approx(sample.levels, abs=sample.tolerance)
    assert any("range" in warning for warning in doors.warnings) == sample.warned

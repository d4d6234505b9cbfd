"""The exact light of a strip, against that of the whole sensor; and the interval of an estimate."""

import numpy as np
from benchmarks.optics.exact import strip_transfer
from tests.oracle.jobs import Job, draw_everyday, light, masks, shown
from tests.oracle.physics import transfer


def a_job() -> Job:
    """The first everyday camera of two columns or more, and scene pixels on either side."""
    drawn = map(draw_everyday, range(100, 200))
    return next(job for job in drawn if job.embedding.columns == 3 and min(job.scene.shape) > 1)


def test_strip_holds_columns_of_the_whole() -> None:
    """Light sampled elsewhere on the sensor is the same: both ways have five samples a fringe."""
    job = a_job()
    optics, amplitudes = light(job), shown(job, masks(job, 1))
    pixel = (0, job.scene.columns - 1)
    whole = transfer(optics, amplitudes, only=pixel).reshape(job.embedding.shape)
    for columns in (slice(0, 2), slice(1, 3)):
        strip = strip_transfer(optics, amplitudes, pixel, columns, reach=1.0, finer=1.0)
        off = np.linalg.norm(strip - whole[:, columns]) / np.linalg.norm(whole[:, columns])
        assert off < 5e-3

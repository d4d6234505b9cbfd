"""Watch events: what the daemon tells of while it works, here of two classifications.

python examples/watch_events.py [URL]
"""

import asyncio
import sys

from veilcam_client import AsyncCamera
from veilcam_client.events import Classified


async def main() -> None:
    """Listen and ask at the same time; end with the second label."""
    async with AsyncCamera(*sys.argv[1:]) as camera, asyncio.TaskGroup() as tasks:
        labels = 0
        tasks.create_task(ask(camera))
        async for event in camera.events():
            print(f"{event.at:%H:%M:%S} {event.kind}")
            labels += isinstance(event, Classified)
            if labels == 2:
                return


async def ask(camera: AsyncCamera) -> None:
    """Classify until the listener has heard enough of it."""
    for _ in range(10):
        await asyncio.sleep(0.1)
        await camera.classify()


asyncio.run(main())

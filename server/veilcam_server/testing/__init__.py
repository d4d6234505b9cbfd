"""Simulated cameras for tests: the daemon and its simulator in this process, on a unix socket.

They need the extra ``server``. pytest finds the fixture ``fake_camera`` by itself.

    from veilcam_server.testing import FakeCamera

    with FakeCamera() as fake, fake.camera() as camera:
        camera.simulation.hold_scene(picture)
        assert camera.classify().label == "7"
"""

from veilcam_server.testing.fake_camera import FakeCamera

__all__ = ["FakeCamera"]

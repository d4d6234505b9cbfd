"""Cameras for tests: the daemon's application and its simulator, in this process, without a socket.

Needs the extra ``server``. With pytest the fixture ``fake_camera`` is there by itself.

    from veilcam_server.testing import FakeCamera

    with FakeCamera() as fake, fake.camera() as camera:
        camera.simulation.hold_scene(picture)
        assert camera.classify().label == "7"
"""

from veilcam_server.testing.fake_camera import FakeCamera

__all__ = ["FakeCamera"]

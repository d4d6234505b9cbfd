"""Page of the daemon: what somebody sees who opens its address in a browser."""

TEXT = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<title>Veilcam</title>
<h1>Veilcam</h1>
<p>This is a camera without a lens. Programs ask it: the command <code>veilcam</code>, or the Python
package <code>veilcam_client</code>.</p>
</html>
"""

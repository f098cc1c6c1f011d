"""An RTSP server on this machine's loopback, to try `spheremcap live rtsp://127.0.0.1:8554/clip` with.

    apt-get install python3-gi gir1.2-gst-rtsp-server-1.0 gir1.2-gstreamer-1.0 gstreamer1.0-plugins-good \
        gstreamer1.0-plugins-bad
    /usr/bin/python3 benchmarks/rtsp_server.py session.mp4

For Debian's own Python, which has GStreamer's bindings. Sends the H.264 of a file in real time, from its beginning to
each who asks; ends with Ctrl-C.
"""

import sys
from pathlib import Path

import gi  # type: ignore[import-not-found]

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # type: ignore[import-not-found]  # noqa: E402


def main() -> None:
    Gst.init(None)
    server, factory = GstRtspServer.RTSPServer(), GstRtspServer.RTSPMediaFactory()
    server.set_address("127.0.0.1")
    server.set_service("8554")
    file = Path(sys.argv[1]).resolve()
    factory.set_launch(f'( filesrc location="{file}" ! qtdemux ! h264parse ! rtph264pay name=pay0 config-interval=1 )')
    server.get_mount_points().add_factory("/clip", factory)
    server.attach(None)
    print("rtsp://127.0.0.1:8554/clip", flush=True)
    GLib.MainLoop().run()


if __name__ == "__main__":
    main()

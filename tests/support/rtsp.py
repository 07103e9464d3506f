"""A camera of the network: a server of RTSP on the loopback, whose H.264 and its packets are PyAV's."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Sequence
from typing import Any

import av

SDP = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
    "a=rtpmap:96 H264/90000\r\na=fmtp:96 packetization-mode=1\r\na=control:video\r\n"
)
MORE = {
    "OPTIONS": "Public: DESCRIBE, SETUP, PLAY, TEARDOWN\r\n",
    "DESCRIBE": f"Content-Type: application/sdp\r\nContent-Length: {len(SDP)}\r\n",
    "SETUP": "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n",
}


def camera(images: Sequence[Any], fps: int = 25) -> str:
    """The address of a camera that shows the images to its first visitor, at their rate, and then is taken away."""
    server = socket.create_server(("127.0.0.1", 0))
    threading.Thread(target=_serve, args=(server, images, fps), daemon=True).start()
    return f"rtsp://127.0.0.1:{server.getsockname()[1]}/live"


def _serve(server: socket.socket, images: Sequence[Any], fps: int) -> None:
    with server, server.accept()[0] as visitor, visitor.makefile("rb") as asked:
        method = ""
        while method != "PLAY":
            lines = list(iter(lambda: asked.readline().decode().strip(), ""))
            if not lines:
                return
            method, number = lines[0].split()[0], next(one for one in lines if one.lower().startswith("cseq"))
            body = SDP if method == "DESCRIBE" else ""
            answer = f"RTSP/1.0 200 OK\r\n{number}\r\nSession: 1\r\n{MORE.get(method, '')}\r\n{body}"
            visitor.sendall(answer.encode())
        _show(visitor, images, fps)


def _show(visitor: socket.socket, images: Sequence[Any], fps: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as packets:
        packets.bind(("127.0.0.1", 0))
        packets.setblocking(False)
        with av.open(f"rtp://127.0.0.1:{packets.getsockname()[1]}", "w", format="rtp") as out:
            options = {"preset": "ultrafast", "tune": "zerolatency"}
            stream: Any = out.add_stream("libx264", rate=fps, options=options)
            stream.height, stream.width = images[0].shape[:2]
            stream.pix_fmt = "yuv420p"
            for image in images:
                out.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
                _pass_on(packets, visitor)
                time.sleep(1 / fps)
            out.mux(stream.encode())
            _pass_on(packets, visitor)


def _pass_on(packets: socket.socket, visitor: socket.socket) -> None:
    """What PyAV sent, which the loopback has at once, in the visitor's connection."""
    while True:
        try:
            packet = packets.recv(65535)
        except BlockingIOError:
            return
        visitor.sendall(b"$\0" + len(packet).to_bytes(2, "big") + packet)

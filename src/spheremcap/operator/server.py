"""The page over HTTP, for this machine alone: pictures as JPEG and PNG, everything else as JSON.

Whoever has the token gets in: it is in the first address, which sets it as a cookie that no script reads and no other
site sends. A request that names another host, or comes from another site's page, is refused. No request holds a path.
"""

import asyncio
import base64
import hmac
import math
import socket
import threading
from collections.abc import Awaitable, Callable
from importlib.resources import files
from secrets import token_urlsafe
from typing import Any, Literal, TypeVar

import anyio.to_thread
import cv2
import numpy as np
import uvicorn
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from spheremcap.core.chair import ChairClick
from spheremcap.core.circle import Circle
from spheremcap.core.frame import BgrImage, Frame, Window
from spheremcap.errors import OutputError, SpheremcapError, UsageError
from spheremcap.io.toml_file import first_problem
from spheremcap.operator.desk import Outdated
from spheremcap.operator.page import Page

STATIC = files("spheremcap.operator") / "static"
_LARGEST_BODY_BYTES = 1 << 20
_PULSE_S, _LONGEST_PULSE_S = 0.1, 10.0
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 92]
_LARGEST_PATCH_PX = 1 << 20
_CROP_PX = 112
_OUTSIDE = 40  # gray

_HEADERS = {
    "content-security-policy": "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False)


_Px = Field(ge=-1e5, le=1e5, allow_inf_nan=False)


class _Circle(_Body):
    x_px: float = _Px
    y_px: float = _Px
    r_px: float = Field(gt=0, le=1e5, allow_inf_nan=False)

    def circle(self) -> Circle:
        return Circle(self.x_px, self.y_px, self.r_px)


class _Answer(_Body):
    kind: Literal["circle", "hidden", "keep"]
    marker: str = Field(max_length=100)
    frame: int = Field(ge=0, le=10**9)
    to_frame: int | None = Field(None, ge=0, le=10**9)
    circle: _Circle | None = None
    author: str | None = Field(None, max_length=100)


class _Which(_Body):
    kind: Literal["circle", "hidden", "keep"] = "circle"
    marker: str = Field(max_length=100)
    frame: int = Field(ge=0, le=10**9)


class _Snap(_Body):
    marker: str = Field(max_length=100)
    frame: int = Field(ge=0, le=10**9)
    circle: _Circle


class _Click(_Body):
    on: str = Field(max_length=20)
    frame: int = Field(ge=0, le=10**9)
    x_px: float = _Px
    y_px: float = _Px

    def click(self) -> ChairClick:
        return ChairClick(self.on, self.frame, self.x_px, self.y_px)


class _ClickChange(_Body):
    was: _Click | None = None
    now: _Click | None = None


class _Marker(_Body):
    name: str = Field(max_length=100)
    diameter_mm: float = Field(gt=0, le=1e6, allow_inf_nan=False)
    was: str | None = Field(None, max_length=100)
    colour: str | tuple[float, float] | None = None


class _Camera(_Body):
    name: str = Field(max_length=100)


class _Preset(_Body):
    preset: str | None = Field(None, max_length=100)


_Said = TypeVar("_Said", bound=_Body)
_Endpoint = Callable[[Request], Awaitable[Response]]


async def _read(request: Request, kind: type[_Said]) -> _Said:
    """The body of a request. Raises UsageError that says what is wrong with it."""
    try:
        return kind.model_validate_json(await _bytes(request))
    except ValidationError as error:
        raise UsageError(f"the request is not what it should be: {first_problem(error)}") from error


async def _bytes(request: Request) -> bytes:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LARGEST_BODY_BYTES:
            raise HTTPException(413, "larger than 1 MB")
    return body


def _number(request: Request, name: str, *, least: int = 0, most: int = 10**9) -> int:
    """A whole number of the query or the path."""
    text = request.path_params.get(name, request.query_params.get(name, ""))
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if not least <= number <= most:
        raise UsageError(f"{name} has to be a whole number from {least} to {most}")
    return number


def application(page: Page) -> Starlette:
    """The page's requests and answers, without the guard (`guarded`)."""
    run = anyio.to_thread.run_sync

    async def index(request: Request) -> Response:
        return HTMLResponse((STATIC / "index.html").read_text(encoding="utf-8"))

    async def session(request: Request) -> Response:
        return JSONResponse(await run(page.session))

    async def pulse(request: Request) -> Response:
        seen, waited_s = request.query_params.get("seen"), 0.0
        while (now := await run(page.pulse))["mark"] == seen and waited_s < _LONGEST_PULSE_S:
            await asyncio.sleep(_PULSE_S)
            waited_s += _PULSE_S
        return JSONResponse(now)

    async def lanes(request: Request) -> Response:
        return JSONResponse(await run(page.lanes))

    async def states(request: Request) -> Response:
        first, last = _number(request, "first"), _number(request, "last")
        return JSONResponse(await run(page.states, first, last))

    async def time(request: Request) -> Response:
        try:
            seconds = float(request.query_params.get("seconds", ""))
        except ValueError:
            raise UsageError("a time is a number of seconds") from None
        return JSONResponse({"frame": await run(page.frame_at, seconds)})

    async def picture(request: Request) -> Response:
        number, offset = _number(request, "frame"), page.opened.offset
        viewer = request.query_params.get("viewer", "")[:40]
        exact = request.query_params.get("exact") == "1"
        frame = await asyncio.wrap_future(page.desk.look(viewer, number - offset, exact=exact))
        if frame is None:
            raise HTTPException(404, f"frame {number} could not be decoded")
        whole = Window(0, 0, frame.width_px, frame.height_px)
        data = await run(lambda: _jpeg(frame.patch(whole)))  # `full` would stay with the frame, which is held
        return Response(data, media_type="image/jpeg", headers=_facts(frame, offset))

    async def beside(number: int) -> Frame:
        frame = await asyncio.wrap_future(page.desk.beside(number - page.opened.offset))
        if frame is None:
            raise HTTPException(404, f"frame {number} could not be decoded")
        return frame

    def _facts(frame: Frame, offset: int) -> dict[str, str]:
        return {"x-frame": str(frame.index + offset), "x-seconds": f"{page.seconds(frame.index + offset):.6f}"}

    async def patch(request: Request) -> Response:
        """Pixels as they are, for a look at single ones."""
        window = Window(*(_number(request, key, least=-100_000, most=100_000) for key in ("x", "y", "width", "height")))
        window = window.clipped(page.opened.pictures.width_px, page.opened.pictures.height_px)
        if not 0 < window.width * window.height <= _LARGEST_PATCH_PX:
            raise UsageError("the window has to be a part of the picture, of a million pixels at most")
        frame = await beside(_number(request, "frame"))
        return Response(await run(_png, frame.patch(window)), media_type="image/png")

    async def crop(request: Request) -> Response:
        """A square around a place, always as large on the screen."""
        x, y, half = (_number(request, key, least=-100_000, most=100_000) for key in ("x", "y", "half"))
        frame = await beside(_number(request, "frame"))
        half = min(max(half, 4), 2000)
        cut = _square(frame, Window(x - half, y - half, 2 * half + 1, 2 * half + 1))
        way = cv2.INTER_AREA if 2 * half > _CROP_PX else cv2.INTER_NEAREST
        return Response(
            await run(lambda: _jpeg(cv2.resize(cut, (_CROP_PX, _CROP_PX), interpolation=way))),  # type: ignore[arg-type]
            media_type="image/jpeg",
        )

    async def answers(request: Request) -> Response:
        return JSONResponse(await run(page.answers))

    async def answer(request: Request) -> Response:
        said = await _read(request, _Answer)
        if (said.circle is None) == (said.kind == "circle") or (said.to_frame is None) == (said.kind != "circle"):
            raise UsageError("a circle has a circle, hidden and keep have a last frame")
        what: dict[str, Any] = said.circle.model_dump() if said.circle is not None else {"to_frame": said.to_frame}
        return JSONResponse(await run(page.answer, said.kind, said.marker, said.frame, what, said.author))

    async def take_back(request: Request) -> Response:
        which = await _read(request, _Which)
        return JSONResponse(await run(page.take_back, which.kind, which.marker, which.frame))

    async def snap(request: Request) -> Response:
        said = await _read(request, _Snap)
        frame = await beside(said.frame)
        snapped = await run(page.snap, frame, said.circle.circle(), said.marker)
        shown = np.zeros((*snapped.mask.shape, 4), np.uint8)
        shown[snapped.mask > 0] = (255, 64, 255, 110)
        return JSONResponse(
            {
                "circle": dict(zip(("x_px", "y_px", "r_px"), snapped.circle, strict=True)),
                "sd_px": [_finite(v) for v in snapped.circle_sd_px],
                "visible": snapped.visible,
                "contrast": _finite(snapped.contrast),
                "against": list(snapped.against),
                "limits": [_finite(v) for v in snapped.limits],
                "mask": "data:image/png;base64," + base64.b64encode(_png(shown)).decode(),
                "window": [snapped.window.x, snapped.window.y, snapped.window.width, snapped.window.height],
                "selected": int((snapped.mask > 0).sum()),
                "distance_m": snapped.distance_m,
                "distance_sd_m": snapped.distance_sd_m,
            }
        )

    async def chair(request: Request) -> Response:
        return JSONResponse(await run(page.chair))

    async def click(request: Request) -> Response:
        change = await _read(request, _ClickChange)
        was, now = (None if one is None else one.click() for one in (change.was, change.now))
        return JSONResponse(await run(page.click, was, now))

    async def marker(request: Request) -> Response:
        said = await _read(request, _Marker)
        await run(page.set_marker, said.name, said.diameter_mm / 1000, said.was, said.colour)
        return JSONResponse(await run(page.session))

    async def drop_marker(request: Request) -> Response:
        said = await _read(request, _Which)
        await run(page.drop_marker, said.marker)
        return JSONResponse(await run(page.session))

    async def camera(request: Request) -> Response:
        said = await _read(request, _Camera)
        await run(page.choose_camera, said.name)
        return JSONResponse(await run(page.pulse))

    async def preset(request: Request) -> Response:
        said = await _read(request, _Preset)
        await run(page.set_preset, said.preset)
        return JSONResponse(await run(page.session))

    async def calibration(request: Request) -> Response:
        try:
            text = (await _bytes(request)).decode()
        except UnicodeDecodeError:
            raise UsageError("the calibration is no text: choose a ROS camera_info YAML") from None
        await run(page.set_calibration, text)
        return JSONResponse(await run(page.session))

    async def track_again(request: Request) -> Response:
        which = await _read(request, _Which)
        await run(page.track_again, which.marker, which.frame)
        return JSONResponse(await run(page.pulse))

    async def trial(request: Request) -> Response:
        return JSONResponse(await run(page.trial_shown))

    def doing(act: Callable[[], Any]) -> _Endpoint:
        async def do(request: Request) -> Response:
            said = await run(act)
            return JSONResponse({"said": said, **await run(page.pulse)})

        return do

    async def refused(request: Request, error: Exception) -> Response:
        status = 500 if isinstance(error, OutputError) else 400
        return PlainTextResponse(str(error), status)

    async def outdated(request: Request, error: Exception) -> Response:
        return PlainTextResponse("a newer look came", 409)

    async def http_error(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        return PlainTextResponse(error.detail, error.status_code)

    def post(path: str, endpoint: _Endpoint) -> Route:
        return Route(path, endpoint, methods=["POST"])

    return Starlette(
        routes=[
            Route("/", index),
            Route("/session", session),
            Route("/pulse", pulse),
            Route("/lanes", lanes),
            Route("/states", states),
            Route("/time", time),
            Route("/picture/{frame}", picture),
            Route("/patch/{frame}", patch),
            Route("/crop/{frame}", crop),
            Route("/answers", answers),
            post("/answer", answer),
            post("/take-back", take_back),
            post("/snap", snap),
            Route("/chair", chair),
            post("/click", click),
            post("/marker", marker),
            post("/drop-marker", drop_marker),
            post("/camera", camera),
            post("/preset", preset),
            post("/calibration", calibration),
            post("/track-again", track_again),
            Route("/trial", trial),
            post("/accept", doing(page.accept)),
            post("/discard", doing(page.discard)),
            post("/track", doing(page.track)),
            post("/write", doing(page.write)),
            post("/open-written", doing(page.open_written)),
            post("/propose", doing(page.propose)),
            Route("/proposals", doing(page.proposed)),
            post("/stop", doing(page.work.stop)),
            post("/later", doing(page.later)),
            Mount("/static", StaticFiles(directory=str(STATIC))),
        ],
        exception_handlers={SpheremcapError: refused, Outdated: outdated, HTTPException: http_error},
    )


def _square(frame: Frame, window: Window) -> BgrImage:
    """The window's pixels, dark where it reaches out of the picture."""
    square = np.full((window.height, window.width, 3), _OUTSIDE, np.uint8)
    inside = window.clipped(frame.width_px, frame.height_px)
    if inside.width and inside.height:
        y, x = inside.y - window.y, inside.x - window.x
        square[y : y + inside.height, x : x + inside.width] = frame.patch(inside)
    return square


def _jpeg(image: BgrImage) -> bytes:
    return bytes(cv2.imencode(".jpg", image, _JPEG)[1])


def _png(image: BgrImage) -> bytes:
    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


class Guard:
    """Lets in who has the token, from this page and under this host's own name only."""

    def __init__(self, app: ASGIApp, hosts: frozenset[str], token: str, cookie: str) -> None:
        self._app, self._hosts, self._token, self._cookie = app, hosts, token, cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        request, headers = Request(scope), Headers(scope=scope)
        given = request.query_params.get("token")
        first = given is not None and request.url.path == "/" and request.method == "GET"
        refusal = self._refusal(headers, given if first else request.cookies.get(self._cookie))

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                out = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    out[name] = value
                if first and refusal is None:
                    out.append("set-cookie", f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/")
            await send(message)

        if refusal is not None:
            await PlainTextResponse(refusal, 403)(scope, receive, sent)
        else:
            await self._app(scope, receive, sent)

    def _refusal(self, headers: Headers, token: str | None) -> str | None:
        """Why a request is not let in; None when it is."""
        if headers.get("host") not in self._hosts:
            return "this page is not here under that name"
        origin = headers.get("origin")
        if origin is not None and origin not in {f"http://{host}" for host in self._hosts}:
            return "a page of another site has no business here"
        if headers.get("sec-fetch-site") not in (None, "same-origin", "none") and token is None:
            return "a page of another site has no business here"
        if token is None or not hmac.compare_digest(token.encode(), self._token.encode()):
            return "open the address that `spheremcap annotate` printed: it holds this session's key"
        return None


class Server:
    """The page on a port of this machine, in a thread; a context manager. `url` is what to open.

    `address` is the loopback unless another one of this machine's is given. Raises UsageError when it cannot be had.
    """

    def __init__(self, page: Page, address: str = "127.0.0.1") -> None:
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._socket.bind((address, 0))
            self._socket.listen()  # who comes before the server has begun waits
        except OSError as error:
            self._socket.close()
            raise UsageError(
                f"{address} is no address of this machine's that can be listened on: {error.strerror}"
            ) from error
        port = self._socket.getsockname()[1]
        name = f"[{address}]" if ":" in address else address
        hosts = {f"{name}:{port}"} | ({f"localhost:{port}"} if address in ("127.0.0.1", "::1") else set())
        token = token_urlsafe(24)
        self.url = f"http://{name}:{port}/?token={token}"
        app = Guard(application(page), frozenset(hosts), token, f"spheremcap-{port}")
        config = uvicorn.Config(
            app, log_level="critical", access_log=False, lifespan="off", server_header=False,
            timeout_graceful_shutdown=1, ws="none",
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), name="http", daemon=True)

    def __enter__(self) -> "Server":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join()
        self._socket.close()

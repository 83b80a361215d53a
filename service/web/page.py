"""The workshop's page: plain files of the folder `page`, read once, served by exact name."""

import hashlib
import mimetypes
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from starlette.requests import Request
from starlette.responses import Response

from faultline.service.web.problems import RequestError

FOLDER = Path(__file__).parent / "page"
INDEX = "index.html"

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; font-src 'self'; "
    "connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Nothing inline, nothing from elsewhere, in nobody's frame."""

_TYPES = {".js": "text/javascript", ".mjs": "text/javascript", ".svg": "image/svg+xml", ".woff2": "font/woff2"}
"""Those that the machine's own table may not have, or have otherwise."""


class Asset(NamedTuple):
    """A file: what is in it, its media type and its entity tag."""

    content: bytes
    media_type: str
    tag: str


def load_page(folder: Path = FOLDER) -> Mapping[str, Asset]:
    """Return the files of the folder and those below it, by their path in it; hidden ones are left out."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not any(part.startswith(".") for part in name.split("/")):
            content = path.read_bytes()
            kind = _TYPES.get(path.suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
            text = kind.startswith("text/") or kind in ("image/svg+xml", "application/json")
            tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
            found[name] = Asset(content, f"{kind}; charset=utf-8" if text else kind, tag)
    return found


def serve(page: Mapping[str, Asset], name: str, request: Request) -> Response:
    """Return the file of that name; raises RequestError if there is none."""
    asset = page.get(name)
    if asset is None:
        raise RequestError(404, "no-route", "there is no such file")
    headers = {"etag": asset.tag, "cache-control": "no-cache", "content-security-policy": POLICY}
    if asset.tag in request.headers.get("if-none-match", ""):
        return Response(None, 304, headers)
    return Response(asset.content, 200, {**headers, "content-type": asset.media_type})

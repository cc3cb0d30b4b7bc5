"""One HTML file of a record: nothing in it is fetched from anywhere.

Programs and numbers are packed (gzip, base64), so a page weighs about 280 kB beside its numbers; plain they would
be 1.1 MB. A content security policy in the page forbids every request.
"""

import base64
import functools
import gzip
import hashlib
import html
import json
import re
from pathlib import Path

from jaxrb.errors import JaxrbError
from jaxrb.view.viewer_record import Record

_HERE = Path(__file__).parent
WEB, VENDOR = _HERE / "web", _HERE / "vendor"
# three.js r185.1 as its authors published it (npm, three 0.185.1), MIT.
VENDORED = {
    "three.core.min.js": "05b2609338c76cd65daf74f3ac515bc9a5045e1b3b33edc07d8c9bd55250fa90",
    "three.module.min.js": "86bcee248b64f44bcfc23c331ae74619061957d59cab040171dcb6fb5900beb6",
    "three.LICENSE.txt": "8b378ebe60e2fe500158cb0ac71cb5e8b7d92953c2abcc63a0eb90499653b5bc",
}


def page_of(record: Record) -> str:
    """The page. Text of the user's (names, titles) stands in it as JSON without any `<`, or escaped."""
    filled = {
        "title": html.escape(record.header["title"]),
        "style": _web("style.css"),
        "boot": _web("boot.js"),
        "licence": vendored("three.LICENSE.txt").strip(),
        "record": inert(json.dumps(record.header, allow_nan=False)),
        "numbers": packed(bytes(record.numbers)),
        "program": _program(),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: filled[found[1]], _web("page.html"))


def inert(text: str) -> str:
    """JSON that no HTML parser takes for markup, `</script>` among it."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def packed(data: bytes) -> str:
    """gzip, base64; the same bytes give the same text."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode("ascii")


def vendored(name: str) -> str:
    """A file that others wrote, as they wrote it.

    Raises:
        JaxrbError: it is not there, or was changed.
    """
    file = VENDOR / name
    try:
        data = file.read_bytes()
    except OSError as error:
        raise JaxrbError(f"{file}: cannot be read ({error}); install jaxrb again") from error
    found = hashlib.sha256(data).hexdigest()
    if found != VENDORED[name]:
        raise JaxrbError(
            f"{file}: its SHA-256 is {found[:12]}…, but {VENDORED[name][:12]}… is expected: the file was changed; "
            "install jaxrb again"
        )
    return data.decode("utf-8")


@functools.cache
def _program() -> str:
    """All modules by the names under which they import each other."""
    core, module = vendored("three.core.min.js"), vendored("three.module.min.js")
    modules = {"three/core": core, "three": module.replace('"./three.core.min.js"', '"three/core"')}
    for file in sorted(WEB.glob("*.js")):
        if file.name != "boot.js":
            modules[f"jaxrb/{file.stem}"] = file.read_text(encoding="utf-8")
    return packed(json.dumps(modules).encode())


def _web(name: str) -> str:
    return (WEB / name).read_text(encoding="utf-8")

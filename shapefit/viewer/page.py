"""A scene as one HTML file that needs nothing else: code, style and data inlined."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Iterable, Mapping
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import Any

from shapefit.viewer.scene import Fact, Scene, as_json

SCRIPTS = (
    "blocks.js",
    "geometry.js",
    "scene.js",
    "look.js",
    "plane.js",
    "space.js",
    "chart.js",
    "viewer.js",
)
"""In this order: each file uses only those before it."""


def viewer_page(scene: Scene) -> str:
    """Return the page of a scene.

    Names come from files that anybody may have written: in the markup they are escaped, and the
    script puts them into the document as text only. The Content-Security-Policy lets run the
    script of the page alone, and forbids every request.
    """
    script = "\n".join(resource(f"scripts/{name}") for name in SCRIPTS)
    return fill(
        resource("viewer.html"),
        style=resource("viewer.css"),
        script=script,
        title=escape(scene.title),
        facts="".join(map(_fact, scene.facts)),
        notes=list_items(scene.assumed + scene.notes),
        page=embedded_json(as_json(scene)),
    )


def fill(template: str, *, style: str, script: str, **values: str) -> str:
    """Fill a page: `{{name}}` stands for a value; style and script are the only ones allowed.

    The style begins with the colours of all pages.
    """
    style = resource("palette.css") + style
    policy = content_security_policy(style, script)
    given = {"policy": policy, "style": style, "script": script, **values}
    return re.sub(r"\{\{([a-z]+)\}\}", lambda found: given[found[1]], template)


def resource(name: str) -> str:
    """Return the text of a file of this package."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def content_security_policy(style: str, script: str) -> str:
    """Return the policy of a page with this one style and script: no request leaves the page."""

    def digest(text: str) -> str:
        return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode('ascii')}'"

    return (
        f"default-src 'none'; script-src {digest(script)}; style-src {digest(style)}; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )


def embedded_json(document: Mapping[str, Any]) -> str:
    """Return JSON that can stand in a script element: nothing in it ends or opens an element."""
    text = json.dumps(document, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("&", r"\u0026").replace("<", r"\u003c").replace(">", r"\u003e")


def list_items(lines: Iterable[str]) -> str:
    """Return texts as items of an HTML list."""
    return "".join(f"<li>{escape(line)}</li>" for line in lines)


def _fact(fact: Fact) -> str:
    """Return a fact of the header as an item of an HTML list."""
    title = f' title="{escape(fact.title)}"' if fact.title else ""
    style = f' class="{fact.style}"' if fact.style else ""
    return f"<li{style}{title}>{escape(fact.text)}</li>"

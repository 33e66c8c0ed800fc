"""A scene as one HTML file that needs nothing else: code, style and data inlined."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import Any

from shapefit.viewer.scene import Fact, Scene, as_json

SCRIPTS = ("blocks", "geometry", "scene", "look", "plane", "space", "chart", "viewer")
"""In this order: each file uses only those before it."""


def viewer_page(scene: Scene) -> str:
    """Return the page of a scene.

    Names come from files of any origin: in the markup they are escaped, and the
    script puts them into the document as text only. The Content-Security-Policy lets run the
    script of the page alone, and forbids every request.
    """
    script = "\n".join(resource(f"scripts/{name}.js") for name in SCRIPTS)
    style = resource("palette.css") + resource("viewer.css")
    parts = {
        "policy": content_security_policy(style, script),
        "style": style,
        "script": script,
        "title": escape(scene.title),
        "facts": "".join(map(_fact, scene.facts)),
        "notes": "".join(f"<li>{escape(note)}</li>" for note in (*scene.assumed, *scene.notes)),
        "page": embedded_json(as_json(scene)),
    }
    return re.sub(r"\{\{([a-z]+)\}\}", lambda name: parts[name[1]], resource("viewer.html"))


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


def embedded_json(document: Any) -> str:
    """Return JSON that can stand in a script element: nothing in it ends or opens an element."""
    text = json.dumps(document, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("&", r"\u0026").replace("<", r"\u003c").replace(">", r"\u003e")


def _fact(fact: Fact) -> str:
    """Return a fact of the header as an item of an HTML list."""
    title = f' title="{escape(fact.title)}"' if fact.title else ""
    style = f' class="{fact.style}"' if fact.style else ""
    return f"<li{style}{title}>{escape(fact.text)}</li>"

"""Names are written by unknown: none of them becomes markup or script, none asks for anything."""

import json

import numpy as np
import pytest

from tests.pipelines.view.files import write_result, write_truth

ATTACK = "window.hacked = true"
HOSTILE = (
    f"</script><img src=x onerror='{ATTACK}'>",
    f"<script>{ATTACK}</script>",
    f"\"><svg onload='{ATTACK}'>",
    f"]]><!--<script>{ATTACK}//",
    f"</script ><img src=x onerror='{ATTACK}' ",
    "javascript:window.hacked=true",
    "&lt;b&gt;&amp;\u2028\u202e\x1b[0m{{page}}",
    "../../etc/passwd\nSet-Cookie: a=b",
    "a|b *c* [d](javascript:window.hacked=true)",
)


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    """A result and its truth in which every name is an attack, and so is the rest of the text."""
    folder = tmp_path_factory.mktemp("hostile")
    n, p = len(HOSTILE), 5
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(n, 3, p))
    shapes[-1] = np.nan
    names = tuple(f"{HOSTILE[j]} {j}" for j in range(p))
    items = tuple(f"{text}/{i}" for i, text in enumerate(HOSTILE))
    sequences = tuple(HOSTILE[i // 2] for i in range(n))
    columns = {"landmarks": shapes[:, :2].swapaxes(1, 2)}
    config = {"config": json.dumps({"dictionary": f"/x/{HOSTILE[2]}.h5"})}
    called = {"landmark_names": names, "items": items, "sequences": sequences}
    status = np.array(HOSTILE, dtype=object)
    path = folder / f"{HOSTILE[1].replace('/', '_')}.h5"
    result = write_result(path, shapes, columns, config, status=status, unit=HOSTILE[0], **called)
    true = np.nan_to_num(shapes) + rng.normal(size=shapes.shape)
    edges = np.array([[0, 1], [1, 2]])
    truth = write_truth(folder / "truth.h5", true, edges=edges, unit=HOSTILE[2], **called)
    return result, truth, items, names


def check(page):
    """No script but ours ran, nothing was asked for, and nothing in the page could do either."""
    assert page.run("return window.hacked === undefined")
    assert page.complaints() == []
    assert page.requests() == []
    strange = page.run("""
      const own = new Set(["SCRIPT", "STYLE", "META", "TITLE"]);
      return [...document.querySelectorAll("*")].filter((e) => e.tagName === "SCRIPT" ? e.src :
        ["IFRAME", "OBJECT", "EMBED", "LINK", "BASE", "FORM"].includes(e.tagName) ||
        (e.tagName === "IMG" && !e.src.startsWith("data:image/svg+xml;base64,")) ||
        [...e.attributes].some((a) => a.name.startsWith("on")) ||
        (e.tagName === "A" && !/^\\.\\/[\\w.]+(#item=[^"]*)?$/.test(e.getAttribute("href")))
      ).map((e) => e.outerHTML)""")
    assert strange == []
    assert page.run("return document.scripts.length") <= 2


def test_hostile_names_stay_text_on_the_page_of_results(hostile, view, open_page):
    result, truth, items, _ = hostile
    made = view({HOSTILE[0]: (result,)}, truth=(truth,))
    page = open_page(made.path)
    for frame, item in enumerate(items):
        page.run("shapefit.go(arguments[0])", frame)
        page.settle()
        assert page.state("item") == item
    page.run("shapefit.go(0)")
    page.settle()
    text = page.run("return document.body.textContent")
    assert HOSTILE[0] in text
    check(page)


def test_a_script_that_were_put_into_the_page_would_not_run(hostile, view, open_page):
    """The policy is the second wall: it holds even if a name became markup."""
    made = view({"x": (hostile[0],)})
    broken = made.path.with_name("broken.html")
    attack = (
        f"<script>{ATTACK}</script><img src=x onerror='{ATTACK}'><img src='http://127.0.0.1:9/x'>"
    )
    broken.write_text(made.text.replace("<main>", f"<main>{attack}", 1), encoding="utf-8")
    page = open_page(broken)
    assert page.run("return window.hacked === undefined")
    assert any("Content Security Policy" in line for line in page.complaints())

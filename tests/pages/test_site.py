"""The static site in a real browser: pages, pictures, reference, search; no link leads nowhere."""

from __future__ import annotations

import html
import json
import re
import threading
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from browser import browse

import odt_plugins
from odt_plugins.errors import MeshFileError
from odt_plugins.pages import sources
from odt_plugins.pages.build import build
from odt_plugins.pages.docstrings import apart

TOP = Path(odt_plugins.__file__).parents[1]

PROBE = """<script>
addEventListener("load", () => setTimeout(() => {
  document.body.dataset.probe = JSON.stringify({
    wide: document.documentElement.scrollWidth, window: innerWidth, title: document.title,
    images: [...document.images].filter(i => i.getBoundingClientRect().width)
      .map(i => i.naturalWidth),
    found: [...document.querySelectorAll("#search-results li a")].map(a => a.textContent),
  });
}, 1500));
</script>"""


class Quiet(SimpleHTTPRequestHandler):
    """Serves files without a word."""

    def log_message(self, *_args):
        """Say nothing."""


class Links(HTMLParser):
    """Addresses and anchors of one page."""

    def __init__(self):
        super().__init__()
        self.links, self.anchors = set(), set()

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        self.anchors |= {named["id"]} if named.get("id") else set()
        for name in ("href", "src"):
            if named.get(name):
                self.links.add(named[name])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages") / "site"
    build(folder)
    return folder


@pytest.fixture(scope="module")
def address(site):
    """The site as a browser finds it."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=site))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def seen(site, address, page, tmp_path):
    """What the browser made of a page; it has nothing to complain about."""
    file, _, query = page.partition("?")
    probed = site / file.replace(".html", "-probed.html")
    text = (site / file).read_text(encoding="utf-8")
    probed.write_text(text.replace("</body>", f"{PROBE}</body>"), encoding="utf-8")
    dom, console = browse(f"{address}/{probed.relative_to(site).as_posix()}?{query}", tmp_path,
                          "--virtual-time-budget=9000", "--dump-dom")
    probed.unlink()
    assert console == []
    found = json.loads(html.unescape(re.search(r'data-probe="([^"]*)"', dom).group(1)))
    assert found["wide"] <= found["window"] + 1
    return found


def test_first_page_gallery_and_search_in_a_browser(site, address, tmp_path):
    first = seen(site, address, "index.html", tmp_path)
    assert "odt-plugins" in first["title"]
    assert min(first["images"]) > 300
    gallery = seen(site, address, "examples/README.html", tmp_path)
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", (TOP / "examples/README.md").read_text())
    assert len(gallery["images"]) == len(pictures) > 10
    assert min(gallery["images"]) > 300
    found = seen(site, address, "search.html?q=envelope", tmp_path)["found"]
    assert any("How odt_plugins works" in title for title in found)
    found = seen(site, address, "search.html?q=optimize_with_report", tmp_path)["found"]
    assert any("optimize_with_report" in title for title in found)


def test_every_public_name_and_command_has_its_place(site):
    page = (site / "reference" / "python.html").read_text(encoding="utf-8")
    for name in odt_plugins.__all__:
        assert name == "__version__" or f'id="odt_plugins.{name}"' in page, name
    assert "how far a surface that moves may be" in page.lower()
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    for name in ("optimize", "remesh", "compare", "batch", "cache"):
        assert f'id="odt-plugins-{name}"' in commands, name


def test_no_link_leads_nowhere(site):
    pages = {}
    for file in site.rglob("*.html"):
        pages[file.resolve()] = Links()
        pages[file.resolve()].feed(file.read_text(encoding="utf-8"))
    assert len(pages) > 10
    for file, found in pages.items():
        for link in found.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or link in ("#", "_static/"):
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            assert target.is_file(), (file, link)
            if parts.fragment and target in pages:
                assert unquote(parts.fragment) in pages[target].anchors, (file, link)


def test_meanings_of_entries_stand_below_them():
    told = ["Parameters", "----------", "mesh : object     what is", "                  taken",
            "x : float", "    as it is", "", "Raises", "------", "ValueError     never", "",
            "Words stay     as they are."]
    assert apart(told) == [
        "Parameters", "----------", "mesh : object", "    what is", "    taken", "x : float",
        "    as it is", "", "Raises", "------", "ValueError", "    never", "",
        "Words stay", "    as they are."]
    assert apart(["|H| of ``a|b``", "d |tau|", ">>> a | b"]) == [
        "|H| of ``a|b``", r"d \|tau\|", ">>> a | b"]
    assert apart(["Words stay     as they are."]) == ["Words stay     as they are."]


def test_what_is_no_site_is_left_alone_and_a_package_without_pages_says_so(tmp_path, monkeypatch):
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    with pytest.raises(MeshFileError, match="holds something else than a site"):
        build(tmp_path)
    assert mine.read_text() == "mine"
    monkeypatch.setattr(sources, "TOP", tmp_path)
    with pytest.raises(MeshFileError, match="expected a checkout"):
        build(tmp_path / "site")
    assert not (tmp_path / "site").exists()


def test_a_fault_in_a_page_is_told(tmp_path, monkeypatch):
    fault = "\n".join(["Python", "======", "", ".. no-such-directive::", ""])
    monkeypatch.setattr(sources, "python_page", lambda: fault)
    monkeypatch.setattr(sources, "GUIDES", {"Reference": sources.GUIDES["Reference"]})
    with pytest.raises(MeshFileError, match="got faults in the pages"):
        build(tmp_path / "site")

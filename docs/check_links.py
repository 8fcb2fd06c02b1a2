"""Check the built pages and README.md without a network: ``python docs/check_links.py FOLDER``.

Every relative link, picture and anchor has to exist, and no page may load anything from elsewhere.
Every public name has to have its page. Prints what is wrong; the exit code is 1 if anything is.
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import napari_defocus

README = Path(__file__).parents[1] / "README.md"
LOADED = {"script": "src", "img": "src", "link": "href", "source": "src", "iframe": "src"}
"""What a browser fetches by itself, by tag and attribute."""

GENERATED = {"genindex.html", "search.html"}
"""Their links are made by Sphinx, also to anchors that scripts make."""


class Page(HTMLParser):
    """The anchors of a page, what it links to, and what it loads."""

    def __init__(self, path):
        super().__init__()
        self.anchors, self.links, self.loaded = {"", "top"}, [], []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        """Note what matters of a tag."""
        told = dict(attributes)
        self.anchors |= {told[name] for name in ("id", "name") if told.get(name)}
        if tag == "a" and told.get("href"):
            self.links.append(told["href"])
        if told.get(LOADED.get(tag)) and told.get("rel") not in ("next", "prev", "canonical"):
            self.loaded.append(told[LOADED[tag]])


def main(folder):
    """Print all faults; return 1 if there are any."""
    pages = {path.resolve(): Page(path) for path in pages_in(folder)}
    faults = [
        f"{path.relative_to(folder.resolve())}: {fault}"
        for path, page in pages.items()
        for fault in faults_of(path, page, pages)
    ]
    faults += [f"README.md: {link} does not exist" for link in missing_in_readme()]
    faults += [
        f"napari_defocus.{name} has no page"
        for name in napari_defocus.__all__
        if not (folder / "api" / "generated" / f"napari_defocus.{name}.html").exists()
    ]
    print("\n".join(faults) or f"{len(pages)} pages and README.md: every link leads somewhere")
    return 1 if faults else 0


def pages_in(folder):
    """Return the pages, without the theme's templates."""
    return sorted(path for path in folder.rglob("*.html") if "_static" not in path.parts)


def faults_of(path, page, pages):
    """Yield what is wrong with a page."""
    for address in page.loaded:
        if urlsplit(address).netloc:
            yield f"loads {address}, which needs a network"
    for address in [*page.links, *page.loaded]:
        parts = urlsplit(address)
        if parts.scheme or parts.netloc:
            continue
        target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        if not target.is_file():
            yield f"{address} does not exist"
        elif target in pages and path.name not in GENERATED:
            anchor = unquote(parts.fragment)
            if anchor not in pages[target].anchors:
                yield f"{address}: there is no such anchor"


def missing_in_readme():
    """Return the relative links of README.md that lead nowhere."""
    text = README.read_text(encoding="utf-8")
    links = [urlsplit(link) for link in re.findall(r"\]\(([^)\s]+)\)", text)]
    return [
        link.path
        for link in links
        if link.path and not link.scheme and not (README.parent / unquote(link.path)).exists()
    ]


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        sys.exit(__doc__)
    sys.exit(main(Path(sys.argv[1])))

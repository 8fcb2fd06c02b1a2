"""README.md is a page of the documentation: links to it lead there."""


def lead_to_page(_app, docname, source):
    """Turn links that work in the repository into links that work in the site."""
    up = "../" * (docname.count("/") + 1)
    here = "../" * docname.count("/")
    source[0] = source[0].replace(f"]({up}README.md", f"]({here}readme.md")


def setup(app):
    """Look at every page when it is read."""
    app.connect("source-read", lead_to_page)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

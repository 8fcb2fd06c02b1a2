"""Single backticks in docstrings: a link if they hold a public name, else code."""

from docutils import nodes
from sphinx import addnodes

import napari_defocus


def public_name(name, rawtext, text, lineno, inliner, options=None, content=None):
    """Link `disc` nowhere, `Disc` to its page, `Settings.load` to that method."""
    dotted = text.removeprefix("napari_defocus.")
    code = nodes.literal(rawtext, dotted)
    if dotted.split(".")[0] not in napari_defocus.__all__ or not _is_documented(dotted):
        return [nodes.literal(rawtext, text)], []
    target = f"napari_defocus.{dotted}"
    link = addnodes.pending_xref(
        rawtext, code, refdomain="py", reftype="obj", reftarget=target, refexplicit=True
    )
    link["refdoc"] = inliner.document.settings.env.docname
    return [link], []


def _is_documented(dotted):
    """Tell whether there is such a name, or such a method: fields are told of in their class."""
    name, *rest = dotted.split(".")
    owner = getattr(napari_defocus, name)
    return not rest or callable(getattr(owner, rest[0], None))


def setup(app):
    """Add the role."""
    app.add_role("public-name", public_name)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

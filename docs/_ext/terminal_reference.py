"""``{terminal-reference}``: every command with its arguments and options, from the program."""

import re

import typer
from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from napari_defocus.cli.app import app as program

NAME = "napari-defocus"


class TerminalReference(SphinxDirective):
    """A section a command."""

    def run(self):
        """Ask the program itself, so that page and ``--help`` cannot disagree."""
        group = typer.main.get_command(program)
        context = group.make_context(NAME, [], resilient_parsing=True)
        return [
            self.section(command, command.make_context(name, [], context, resilient_parsing=True))
            for name, command in group.commands.items()
        ]

    def section(self, command, context):
        """Return usage, purpose, arguments and options of a command."""
        title = f"{NAME} {context.info_name}"
        section = nodes.section(ids=[nodes.make_id(context.info_name)], names=[context.info_name])
        section += nodes.title(text=title)
        section += [nodes.paragraph(text=_one_line(text)) for text in command.help.split("\n\n")]
        usage = _one_line(context.get_usage().removeprefix("Usage: "))
        section += nodes.literal_block(usage, usage, language="none")
        section += self.parameters(command, context)
        return section

    @staticmethod
    def parameters(command, context):
        """Return a definition list: it is readable however narrow the screen."""
        records = [parameter.get_help_record(context) for parameter in command.params]
        listed = nodes.definition_list(classes=["terminal-options"])
        for name, told in filter(None, records):
            term = nodes.term("", "", nodes.literal(text=name))
            body = nodes.definition("", nodes.paragraph(text=_one_line(told)))
            listed += nodes.definition_list_item("", term, body)
        return listed


def _one_line(text):
    return re.sub(r"\s+", " ", text).strip()


def setup(app):
    """Add the directive."""
    app.add_directive("terminal-reference", TerminalReference)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

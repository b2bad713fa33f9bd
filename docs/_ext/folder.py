"""Documentation of what a folder of the package exports: ``.. folder::``."""

import re
from importlib import import_module


def exported(page, folder, without):
    """Return the full names of what a folder exports, less what the page or ``without`` names."""
    named = {
        name.rpartition(".")[2] for name in re.findall(r"^\.\. auto\w+:: +([\w.]+)", page, re.M)
    }
    package, module = import_module(folder.partition(".")[0]), import_module(folder)
    for name in module.__all__:
        if name not in named and name not in without.split():
            at_top = getattr(package, name, None) is getattr(module, name)
            yield f"{package.__name__ if at_top else folder}.{name}"


def documentation(full_name):
    """Return what documents a name."""
    module, _, name = full_name.rpartition(".")
    if isinstance(getattr(import_module(module), name), type):
        return f".. autoclass:: {full_name}\n   :members:\n"
    return f".. autofunction:: {full_name}\n"


def setup(app):
    """Register the directive. The tests, which may be without Sphinx, need the rest."""
    from docutils.parsers.rst import directives
    from sphinx.util.docutils import SphinxDirective

    class Folder(SphinxDirective):
        """``.. folder:: tenscontrol.library``, with ``:without:`` what other pages have."""

        required_arguments = 1
        option_spec = {"without": directives.unchanged}  # noqa: RUF012

        def run(self):
            """Return the documentation of each name."""
            page = "\n".join(self.state_machine.input_lines)
            names = exported(page, self.arguments[0], self.options.get("without", ""))
            return self.parse_text_to_nodes("\n".join(map(documentation, names)))

    app.add_directive("folder", Folder)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

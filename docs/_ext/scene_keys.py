"""The tables and keys of scene files, as the package knows them: ``.. scene-keys::``."""

from tenscontrol.scene import schema

# Tables whose keys depend on the first; those of a generator are on the page of the library.
CHOICES = {
    "structure": {
        "": {"generator": schema.TABLES["structure"].keys["generator"], **schema.MEMBERS}
    },
    "strings": schema.LAW_KEYS,
    "ground": schema.GROUND_KEYS,
    "controller": schema.CONTROLLER_KEYS,
    "faults": schema.FAULT_KEYS,
}


def table(name):
    """Return the keys of a table as reStructuredText, each with the choices that have it."""
    known = schema.TABLES[name]
    choices, goes_with = CHOICES.get(name, {"": known.keys}), {}
    for choice, keys in choices.items():
        for key, value in keys.items():
            goes_with.setdefault((key, value.unit, value.meaning), (value, []))[1].append(choice)
    lines = [f"``[{name}]``", f"   {known.meaning.capitalize()}.", "", "   .. list-table::"]
    lines += ["      :header-rows: 1", "      :widths: 15 10 55 20", ""]
    for row in [("Key", "Unit", "Meaning", "With"), *_rows(goes_with, len(choices))]:
        lines += [f"      {'*' if i == 0 else ' '} - {cell}" for i, cell in enumerate(row)]
    return "\n".join([*lines, ""])


def _rows(goes_with, count):
    for (key, unit, meaning), (value, choices) in goes_with.items():
        default = "" if value.default in (None, ()) else f" (default ``{value.default}``)"
        text = meaning.replace("*", r"\*").replace("|", r"\|")
        yield f"``{key}``", unit, text + default, ", ".join(choices) if len(choices) < count else ""


def setup(app):
    """Register the directive. The tests, which may be without Sphinx, need the rest."""
    from sphinx.util.docutils import SphinxDirective

    class SceneKeys(SphinxDirective):
        """All tables, one after the other."""

        def run(self):
            """Return the tables."""
            return self.parse_text_to_nodes("\n".join(table(name) for name in schema.TABLES))

    app.add_directive("scene-keys", SceneKeys)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

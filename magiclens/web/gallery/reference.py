"""Reference pages, made from the code itself, so that they are never out of date."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import magiclens
from magiclens.config.model import Spec
from magiclens.contract import hookspecs
from magiclens.contract.stages import KINDS
from magiclens.plan.registry import EXECUTOR, SCENARIO, STAGE, Registry
from magiclens.profiles.machines import PROCESSES, machines
from magiclens.profiles.materials import materials
from magiclens.web.gallery.docs import DOCS_FOLDER, first_line
from magiclens.web.gallery.docstrings import prose, sections
from magiclens.web.gallery.options import model_tables
from magiclens.web.gallery.parts import Block, Code, Images, Part, ReferencePage, Table, Text
from magiclens.web.gallery.pictures import Album

_ART_SIDE = 160
"""Width and height of the pictures of built-in art, pixels."""
Commands = Mapping[str, Any]
"""The commands of the command line by name, as click has them."""


def reference_pages(registry: Registry, commands: Commands, album: Album) -> list[ReferencePage]:
    """Make all reference pages.

    Args:
        registry: Installed scenarios, stages, executors and art.
        commands: The commands of the command line.
        album: Takes the pictures of built-in art.
    """
    return [
        ReferencePage(
            f"{DOCS_FOLDER}/reference/spec.html", "Spec", "What a spec may say, key by key.", _spec(registry)
        ),
        ReferencePage(
            f"{DOCS_FOLDER}/reference/stages.html",
            "Stages",
            "Every stage of the pipeline that is installed, by kind, with its options.",
            _stages(registry),
        ),
        ReferencePage(
            f"{DOCS_FOLDER}/reference/commands.html",
            "Commands",
            "What `mlens` can be told.",
            _commands(commands) + _executors(registry),
        ),
        ReferencePage(
            f"{DOCS_FOLDER}/reference/plugins.html",
            "Hooks and contracts",
            "What a plugin can implement, and the names that it may import from `magiclens`.",
            _plugins(),
        ),
        ReferencePage(
            f"{DOCS_FOLDER}/reference/machines.html",
            "Machines and materials",
            "What `fabrication.machine` and `lens.material` can be.",
            _profiles(),
        ),
        ReferencePage(
            f"{DOCS_FOLDER}/reference/art.html",
            "Art",
            "Built-in pictures: `{art: panda}` in a spec.",
            [Part("Pictures", "", [Images(_art(registry, album))])],
        ),
    ]


def _spec(registry: Registry) -> list[Part]:
    """The keys of a spec, then those of each scenario."""
    whole = [Part("Top level", first_line(Spec.__doc__), model_tables(Spec))]
    classes = registry.classes(SCENARIO)
    return whole + [Part(f"scenario: {name}", prose(cls), model_tables(cls)) for name, cls in classes.items()]


def _stages(registry: Registry) -> list[Part]:
    parts = []
    for kind in KINDS:
        for name, cls in registry.classes(STAGE, kind).items():
            by = f" Version {cls.version}, from {registry.contributions[STAGE, kind, name].plugin}."
            parts.append(Part(f"{kind}: {name}", prose(cls) + by, model_tables(cls)))
    return parts


def _commands(commands: Commands) -> list[Part]:
    parts = []
    for name, command in sorted(commands.items()):
        context = command.make_context(f"mlens {name}", [], resilient_parsing=True)
        usage = Code(command.get_usage(context).removeprefix("Usage: "), "sh")
        records = [parameter.get_help_record(context) for parameter in command.params]
        rows = [(f"`{written.strip()}`", meaning) for written, meaning in filter(None, records)]
        parts.append(Part(f"mlens {name}", command.help or "", [usage, Table("", ("Word", "What it is"), rows)]))
    return parts


def _executors(registry: Registry) -> list[Part]:
    """The values of ``--executor``, and the options that ``--executor-set`` takes."""
    classes = registry.classes(EXECUTOR)
    return [Part(f"--executor {name}", prose(cls), model_tables(cls)) for name, cls in classes.items()]


def _plugins() -> list[Part]:
    hooks = [
        Part(name, prose(hook), [Code(_signature(name, hook), "python"), *sections(hook)]) for name, hook in _hooks()
    ]
    kinds = [Part(f"kind: {kind}", prose(cls), [*sections(cls), *_methods(cls)]) for kind, cls in KINDS.items()]
    return [*hooks, *kinds, Part("Public names", "`from magiclens import ...`", [_public()])]


def _hooks() -> list[tuple[str, Any]]:
    return [(name, value) for name, value in vars(hookspecs).items() if name.startswith("mlens_")]


def _methods(cls: type[Any]) -> list[Block]:
    """Signatures and docstrings of the methods that a stage implements."""
    blocks: list[Block] = []
    for name, method in vars(cls).items():
        if inspect.isfunction(method) and not name.startswith("_"):
            blocks += [Code(_signature(name, method), "python"), Text(prose(method)), *sections(method)]
    return blocks


def _signature(name: str, function: Any) -> str:
    """A signature as it is written in code, with one parameter a line if there are several."""
    signature = inspect.signature(function)
    found = [_parameter(parameter) for parameter in signature.parameters.values()]
    listed = "".join(f"\n    {parameter}," for parameter in found) + "\n" if len(found) > 1 else "".join(found)
    return f"def {name}({listed}) -> {signature.return_annotation}:"


def _parameter(parameter: inspect.Parameter) -> str:
    """A parameter with its type, and with its default by name."""
    empty = inspect.Parameter.empty
    text = parameter.name if parameter.annotation is empty else f"{parameter.name}: {parameter.annotation}"
    default = parameter.default
    return text if default is empty else f"{text} = {getattr(default, '__name__', repr(default))}"


def _public() -> Table:
    rows = [(f"`{name}`", first_line(getattr(magiclens, name).__doc__)) for name in sorted(magiclens.__all__)]
    return Table("", ("Name", "What it is"), [row for row in rows if not row[1].startswith("Annotated")])


def _profiles() -> list[Part]:
    parts = []
    for name, profile in machines().items():
        rows = _rows(profile.options) + _rows({f"lens.{key}": value for key, value in profile.lens.items()})
        rows += _rows(
            {f"{kind}.{key}": v for kind, stage in profile.stages.items() for key, v in stage.items() if key != "type"}
        )
        text = f"{_sentence(profile.title)} Process: {profile.process}. Numbers: {profile.source}"
        parts.append(Part(name, text, [Table("", ("Key", "Value"), rows)]))
    for process, model in PROCESSES.items():
        text = "Any of these can be overridden beside `machine`."
        parts.append(Part(f"Options of {process}", text, model_tables(model)))
    rows = [
        (f"`{name}`", m.title, f"{m.ior:g}", f"{m.density:g}", f"{m.price:g}", m.source)
        for name, m in materials().items()
    ]
    head = ("Name", "What it is", "Index of refraction", "g/cm³", "EUR/kg", "Source")
    return [*parts, Part("Materials", "", [Table("", head, rows)])]


def _art(registry: Registry, album: Album) -> list[tuple[str, Any]]:
    """Every picture, drawn small."""
    import numpy as np
    from PIL import Image

    from magiclens.images.colour import to_display

    shown = []
    for name, draw in registry.art.items():
        values = np.rint(to_display(draw(_ART_SIDE)) * 255).astype(np.uint8)
        image = Image.fromarray(np.ascontiguousarray(np.broadcast_to(values, (_ART_SIDE, _ART_SIDE, 3))))
        shown.append((name, album.drawn(image, "art", name, f"the picture called {name}")))
    return shown


def _rows(values: dict[str, Any]) -> list[tuple[str, ...]]:
    return [(f"`{key}`", f"`{_value(value)}`") for key, value in values.items()]


def _value(value: Any) -> str:
    return f"[{', '.join(map(str, value))}]" if isinstance(value, list | tuple) else str(value)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."

"""Reference pages, made from the code itself: nobody can forget to bring them up to date."""

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
from magiclens.web.gallery.docs import FOLDER, first_line
from magiclens.web.gallery.options import model_tables
from magiclens.web.gallery.parts import Block, Code, Images, Part, ReferencePage, Table, Text
from magiclens.web.gallery.pictures import Album

ART_PX = 160
Commands = Mapping[str, Any]


def reference(registry: Registry, commands: Commands, album: Album) -> list[ReferencePage]:
    """Every reference page. commands: those of the command line, as click has them, by name."""
    return [
        ReferencePage(f"{FOLDER}/reference/spec.html", "Spec", "What a spec may say, key by key.", _spec(registry)),
        ReferencePage(
            f"{FOLDER}/reference/stages.html",
            "Stages",
            "Every stage of the pipeline that is installed, by kind, with its options.",
            _stages(registry),
        ),
        ReferencePage(
            f"{FOLDER}/reference/commands.html",
            "Commands",
            "What `mlens` can be told.",
            _commands(commands) + _executors(registry),
        ),
        ReferencePage(
            f"{FOLDER}/reference/plugins.html",
            "Hooks and contracts",
            "What a plugin can implement, and the names that it may import from `magiclens`.",
            _plugins(),
        ),
        ReferencePage(
            f"{FOLDER}/reference/machines.html",
            "Machines and materials",
            "What `fabrication.machine` and `lens.material` can be.",
            _profiles(),
        ),
        ReferencePage(
            f"{FOLDER}/reference/art.html",
            "Art",
            "Built-in pictures: `{art: panda}` in a spec.",
            [Part("Pictures", "", [Images(_art(registry, album))])],
        ),
    ]


def _spec(registry: Registry) -> list[Part]:
    """The keys of a spec, then those of each scenario."""
    whole = [Part("Top level", first_line(Spec.__doc__), model_tables(Spec))]
    classes = registry.classes(SCENARIO)
    return whole + [Part(f"scenario: {name}", _words(cls), model_tables(cls)) for name, cls in classes.items()]


def _stages(registry: Registry) -> list[Part]:
    parts = []
    for kind in KINDS:
        for name, cls in registry.classes(STAGE, kind).items():
            by = f" Version {cls.version}, from {registry.contributions[STAGE, kind, name].plugin}."
            parts.append(Part(f"{kind}: {name}", _words(cls) + by, model_tables(cls)))
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
    """What ``--executor`` can be, and the options that ``--executor-set`` takes."""
    classes = registry.classes(EXECUTOR)
    return [Part(f"--executor {name}", _words(cls), model_tables(cls)) for name, cls in classes.items()]


def _plugins() -> list[Part]:
    hooks = [Part(name, _words(hook), [Code(_signature(name, hook), "python")]) for name, hook in _hooks()]
    kinds = [Part(f"kind: {kind}", _words(cls), _methods(cls)) for kind, cls in KINDS.items()]
    return [*hooks, *kinds, Part("Public names", "`from magiclens import ...`", [_public()])]


def _hooks() -> list[tuple[str, Any]]:
    return [(name, value) for name, value in vars(hookspecs).items() if name.startswith("mlens_")]


def _methods(cls: type[Any]) -> list[Block]:
    """Signatures and docstrings of what a stage implements."""
    blocks: list[Block] = []
    for name, method in vars(cls).items():
        if inspect.isfunction(method) and not name.startswith("_"):
            blocks += [Code(_signature(name, method), "python"), Text(_words(method))]
    return blocks


def _signature(name: str, function: Any) -> str:
    """As it is written, one parameter a line where there are several."""
    signature = inspect.signature(function)
    found = [_parameter(parameter) for parameter in signature.parameters.values()]
    listed = "".join(f"\n    {parameter}," for parameter in found) + "\n" if len(found) > 1 else "".join(found)
    return f"def {name}({listed}) -> {signature.return_annotation}:"


def _parameter(parameter: inspect.Parameter) -> str:
    """With its type, and its default by name."""
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
        facts = _pairs(profile.options) + _pairs({f"lens.{key}": value for key, value in profile.lens.items()})
        facts += _pairs(
            {f"{kind}.{key}": v for kind, stage in profile.stages.items() for key, v in stage.items() if key != "type"}
        )
        text = f"{_sentence(profile.title)} Process: {profile.process}. Numbers: {profile.source}"
        parts.append(Part(name, text, [Table("", ("Key", "Value"), facts)]))
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
        values = np.rint(to_display(draw(ART_PX)) * 255).astype(np.uint8)
        image = Image.fromarray(np.ascontiguousarray(np.broadcast_to(values, (ART_PX, ART_PX, 3))))
        shown.append((name, album.drawn(image, "art", name, f"the picture called {name}")))
    return shown


def _pairs(facts: dict[str, Any]) -> list[tuple[str, ...]]:
    return [(f"`{key}`", f"`{_value(value)}`") for key, value in facts.items()]


def _value(value: Any) -> str:
    return f"[{', '.join(map(str, value))}]" if isinstance(value, list | tuple) else str(value)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _words(thing: Any) -> str:
    """A docstring as running text."""
    return inspect.getdoc(thing) or ""

"""The commands that say what is installed: ``mlens plugins`` and ``mlens schema``."""

from __future__ import annotations

import json

import typer

from magiclens.cli.common import AsJson, print_result, reporting


def plugins_command(as_json: AsJson = False) -> None:
    """List every stage, scenario and picture that is installed, and plugins that failed to load."""
    with reporting(False):
        from magiclens.plan.listing import describe_plugins, plugins_data
        from magiclens.plan.registry import Registry

        registry = Registry.load()
        print_result(lambda: describe_plugins(registry), lambda: plugins_data(registry), as_json=as_json)


def schema_command() -> None:
    """Print the JSON Schema (draft 7) of specs, for editors."""
    with reporting(False):
        from magiclens.config.schema import json_schema
        from magiclens.contract.stages import KINDS
        from magiclens.plan.registry import NAMED_ART, SCENARIO, STAGE, Registry

        registry = Registry.load()
        stages = {kind: registry.classes(STAGE, kind) for kind in KINDS}
        typer.echo(json.dumps(json_schema(registry.classes(SCENARIO), stages, registry.types(NAMED_ART)), indent=2))
